//! Affine maps x_k = a + C x_{k+m} with covariance A + C P Cᵀ, and their compositions.

use super::gain::Back;
use super::small::{Matrix, Vector, apply, congruence_plus, product};

/// x_k from x_{k+m} over m steps, first step first: C = C₁C₂, A = A₁ + C₁A₂C₁ᵀ.
pub(super) fn composed<const N: usize>(first: &Back<N>, second: &Back<N>) -> Back<N> {
    Back { c: product(&first.c, &second.c), a: congruence_plus(&first.c, &second.a, &first.a) }
}

pub(super) fn shifted<const N: usize>(first: &Vector<N>, c: &Matrix<N>, second: &Vector<N>) -> Vector<N> {
    let drawn = apply(c, second);
    std::array::from_fn(|i| first[i] + drawn[i])
}

/// Maps of samples in a row: per group the data-free part, per joint the shift a.
#[derive(Debug, Clone)]
pub(super) struct Maps<const N: usize> {
    pub back: Vec<Back<N>>,
    pub shift: Vec<Vector<N>>,
    pub len: usize,
}

impl<const N: usize> Maps<N> {
    pub fn new(entries: usize, groups: usize, joints: usize) -> Self {
        let zero = Back { c: [[0.0; N]; N], a: [[0.0; N]; N] };
        Self { back: vec![zero; entries * groups], shift: vec![[0.0; N]; entries * joints], len: 0 }
    }
}

/// Compositions of m converged maps, m = 1, 2, …: they depend on m alone.
#[derive(Debug, Clone)]
pub(super) struct Powers<const N: usize> {
    pub table: Vec<Back<N>>,
    pub len: usize,
    /// Which converged step they belong to, per group.
    pub version: u64,
}
