"""The estimator in plain numpy, as it was before its hot path was compiled: the check on that."""
