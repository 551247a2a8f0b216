"""The C estimator's twin, bit for bit: a Kalman filter with fixed-lag smoothing over late fixes."""
