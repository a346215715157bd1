"""The runtime: body frame, imputation, estimator, model file, sinks, run loop, command line."""
