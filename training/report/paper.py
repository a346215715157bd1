"""The figures of the paper (Liu, Zhang, Wang, McMillan 2006), to be put beside ours.

Shares are 0 to 1, lengths frames of 1/120 s, as its captures have them; the section that states a
figure follows it.
"""

from __future__ import annotations

# Errors over the test sequences (4.2): mm per marker, and velocity errors of a unit not stated.
RMS_MM = 45.0
NN_RMS_MM = 56.0
JERK = 20.0
NN_JERK = 76.0
RMS_RATIO = RMS_MM / NN_RMS_MM
JERK_RATIO = JERK / NN_JERK
JERK_REDUCED_BY = 0.80  # 4.2: "in most of the sequences"

# The classifier (4.2).
FOREST_ERROR = 0.0029

# Time per frame in seconds, in Matlab on a laptop with 1.4 GHz (4.2).
CLASSIFICATION_S = 0.00012
RECONSTRUCTION_S = 0.0014
FRAME_S = 0.0015
FRAMES_PER_SECOND = 600  # 4.2: "over 600"

# Segments of the training set and local models (4.2).
SEGMENTS = 271
SEGMENT_MIN, SEGMENT_MAX = 128, 3670
SEGMENT_MEAN, SEGMENT_SD, SEGMENT_MEDIAN = 560, 425, 440
DIMENSION_WALK, DIMENSION_SALSA = 2, 14
LEAVES = 65
FEATURE_COMPONENTS = 40  # 3.2.2: fewer of them cover FEATURE_VARIANCE of the segments' features
FEATURE_VARIANCE = 0.95

# Figure 3 (3.1): principal components of a set of 12,670 frames with 40 markers.
PCA_FRAMES, PCA_FEATURES = 12_670, 120
PCA_COMPONENTS_95 = 10  # cover 95 % of the variance
PCA_COMPONENTS_99 = 20  # fewer cover 99 %

# Figure 4 (3.1.2): principal markers selected in repeated runs, on the same set.
SELECTION_RUNS = 1000
SELECTED_MARKERS = 7
SELECTED_IN = 0.94  # each of them in more than this share of the runs

# Figure 5 (3.2.1): two principal components of walking cover more than this share.
WALK_VARIANCE = 0.90

# The captures (4.2).
TRAIN_SEQUENCES, TRAIN_FRAMES, TRAIN_SUBJECTS = 132, 151_882, 21
TEST_SEQUENCES, TEST_FRAMES, TEST_SUBJECTS, TEST_NEW_SUBJECTS = 28, 19_553, 18, 4
