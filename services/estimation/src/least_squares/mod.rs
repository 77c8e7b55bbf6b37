//! Linear least squares.
