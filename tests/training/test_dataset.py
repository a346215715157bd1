import shutil

import numpy as np
import pytest

from drivers.c3d_file import write_c3d
from drivers.errors import UsageError
from drivers.frame import Layout
from drivers.marker_set import MARKERS
from training.dataset import DatasetError, digest, load, load_training, manifest_splits
from training.poses import body_poses


@pytest.fixture
def folder(tmp_path):
    """Two files of random poses, without a manifest."""
    random = np.random.default_rng(0)
    (tmp_path / "deep").mkdir()
    for name in ("a.c3d", "b.c3d"):
        xyz = random.normal(size=(20, len(MARKERS), 3)).astype(np.float32)
        write_c3d(tmp_path / name, Layout(MARKERS, 100.0), xyz)
    (tmp_path / "a.c3d").rename(tmp_path / "deep" / "a.C3D")
    return tmp_path


def manifest(folder, *rows):
    (folder / "manifest.csv").write_text("\n".join(rows) + "\n")


def test_the_manifest_tells_who_and_what(small_dir):
    warnings = []
    takes = load(small_dir, None, warnings.append)
    walk = {take.name: take for take in takes}["real/07_12.c3d"]
    assert (walk.subject, walk.motion, walk.split, walk.real) == ("07", "brisk walk", "test", True)
    assert walk.xyz.shape == (263, 41, 3)
    assert walk.rate == 120.0
    assert np.isnan(walk.xyz).any()  # 0.074 % of its samples
    assert not warnings


def test_training_never_sees_the_test_split(small_dir):
    assert {take.split for take in load_training(small_dir, print)} == {"train"}
    assert [take.name for take in load(small_dir, "test", print)] == ["real/07_12.c3d"]


def test_a_folder_without_manifest_is_all_for_training(folder):
    takes = load_training(folder, print)
    assert [take.name for take in takes] == ["b.c3d", "deep/a.C3D"]
    assert {(take.subject, take.split, take.real, take.rate) for take in takes} == {
        ("unknown", "", True, 100.0)
    }


@pytest.mark.parametrize("with_manifest", [False, True])
def test_a_split_that_is_not_there_is_wrong_usage(folder, with_manifest):
    if with_manifest:
        manifest(folder, "file,split", "b.c3d,train")
    with pytest.raises(UsageError, match="no split 'test'"):
        load(folder, "test", print)


def test_a_manifest_whose_splits_lack_train_is_an_error(folder):
    manifest(folder, "file,split", "b.c3d,test")
    with pytest.raises(DatasetError, match="none named 'train'"):
        load_training(folder, print)
    assert manifest_splits(folder) == ["test"]


def test_files_that_cannot_be_used_are_left_out_by_name(folder):
    (folder / "text.c3d").write_text("this is no C3D file")
    write_c3d(folder / "few.c3d", Layout(MARKERS[:5], 120.0), np.ones((9, 5, 3), np.float32))
    whole = (folder / "b.c3d").read_bytes()
    (folder / "cut.c3d").write_bytes(whole[:300])
    warnings = []
    assert [take.name for take in load(folder, None, warnings.append)] == ["b.c3d", "deep/a.C3D"]
    told = "\n".join(warnings)
    assert len(warnings) == 3
    assert "text.c3d" in told
    assert "cut.c3d" in told
    assert "few.c3d: lacks the markers" in told
    assert "C7" not in told.partition("lacks the markers")[2].split("\n")[0].split(", ")


def test_a_file_that_the_manifest_names_but_is_gone_is_left_out(folder):
    manifest(folder, "file,subject", "b.c3d,ann", "gone.c3d,ann")
    warnings = []
    assert [take.subject for take in load(folder, None, warnings.append)] == ["ann"]
    assert "gone.c3d: no such file" in warnings[0]


def test_nothing_to_work_on_is_a_clear_error(tmp_path):
    with pytest.raises(DatasetError, match="no C3D file"):
        load(tmp_path, None, print)
    with pytest.raises(DatasetError, match="no such folder"):
        load(tmp_path / "gone", None, print)
    manifest(tmp_path, "name,who", "a.c3d,ann")
    with pytest.raises(DatasetError, match="column 'file'"):
        load(tmp_path, None, print)
    manifest(tmp_path, "file,who", "a.c3d,ann", "b.c3d,bob", "a.c3d,ann")
    with pytest.raises(DatasetError, match=r"names a\.c3d in more than one row"):
        load(tmp_path, None, print)
    (tmp_path / "manifest.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DatasetError, match="not a readable table"):
        load(tmp_path, None, print)


def test_the_digest_knows_content_and_name(folder):
    takes = load(folder, None, print)
    first = digest(folder, takes)
    assert digest(folder, takes[::-1]) == first
    assert digest(folder, takes[:1]) != first
    shutil.copy(folder / "b.c3d", folder / "deep" / "a.C3D")
    assert digest(folder, takes) != first


def test_poses_are_in_the_body_frame_and_whole(small_dir):
    take = load(small_dir, "test", print)[0]
    poses = body_poses(take.xyz)
    whole = ~np.isnan(take.xyz).any(axis=(1, 2))
    assert len(poses) == whole.sum() < len(take.xyz)
    c7, left, right = (MARKERS.index(label) for label in ("C7", "LSHO", "RSHO"))
    np.testing.assert_array_equal(poses[:, c7], 0.0)
    across = poses[:, right] - poses[:, left]
    np.testing.assert_allclose(across[:, 1], 0.0, atol=1e-6)
    assert (across[:, 0] > 0.2).all()
    height = take.xyz[whole][..., 2] - take.xyz[whole][:, c7, None, 2]
    np.testing.assert_allclose(poses[..., 2], height, atol=1e-6)
