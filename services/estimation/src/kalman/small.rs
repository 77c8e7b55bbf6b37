//! Matrices of 3 or 4 rows, as plain arrays: row i, column j is `m[i][j]`.

/// N × N matrix.
pub(super) type Matrix<const N: usize> = [[f64; N]; N];
/// Vector of N.
pub(super) type Vector<const N: usize> = [f64; N];

pub(super) fn identity<const N: usize>() -> Matrix<N> {
    let mut m = [[0.0; N]; N];
    for i in 0..N {
        m[i][i] = 1.0;
    }
    m
}

/// A B.
#[inline]
pub(super) fn product<const N: usize>(a: &Matrix<N>, b: &Matrix<N>) -> Matrix<N> {
    let mut m = [[0.0; N]; N];
    for i in 0..N {
        for k in 0..N {
            for j in 0..N {
                m[i][j] += a[i][k] * b[k][j];
            }
        }
    }
    m
}

/// A x.
#[inline]
pub(super) fn apply<const N: usize>(a: &Matrix<N>, x: &Vector<N>) -> Vector<N> {
    let mut y = [0.0; N];
    for i in 0..N {
        for j in 0..N {
            y[i] += a[i][j] * x[j];
        }
    }
    y
}

pub(super) fn transposed<const N: usize>(a: &Matrix<N>) -> Matrix<N> {
    std::array::from_fn(|i| std::array::from_fn(|j| a[j][i]))
}

/// B + A S Aᵀ for symmetric S and B, exactly symmetric.
#[inline]
pub(super) fn congruence_plus<const N: usize>(a: &Matrix<N>, s: &Matrix<N>, b: &Matrix<N>) -> Matrix<N> {
    let t = product(a, s);
    let mut m = *b;
    for i in 0..N {
        for j in i..N {
            let mut sum = b[i][j];
            for k in 0..N {
                sum += t[i][k] * a[j][k];
            }
            m[i][j] = sum;
            m[j][i] = sum;
        }
    }
    m
}

/// A S Aᵀ for symmetric S, exactly symmetric.
#[inline]
pub(super) fn congruence<const N: usize>(a: &Matrix<N>, s: &Matrix<N>) -> Matrix<N> {
    congruence_plus(a, s, &[[0.0; N]; N])
}

/// (M + Mᵀ)/2.
pub(super) fn symmetrised<const N: usize>(m: &Matrix<N>) -> Matrix<N> {
    std::array::from_fn(|i| std::array::from_fn(|j| 0.5 * (m[i][j] + m[j][i])))
}

/// Lower Cholesky factor of a symmetric matrix, or `None` if a pivot is not above `floor` times its diagonal
/// entry (Cholesky does not care for the units of rows and columns, and neither does that test).
#[inline]
pub(super) fn cholesky<const N: usize>(s: &Matrix<N>, floor: f64) -> Option<Matrix<N>> {
    let mut l = [[0.0; N]; N];
    for j in 0..N {
        let mut pivot = s[j][j];
        for k in 0..j {
            pivot -= l[j][k] * l[j][k];
        }
        if pivot.is_nan() || pivot <= floor * s[j][j] {
            return None;
        }
        l[j][j] = pivot.sqrt();
        let inverse = 1.0 / l[j][j];
        for i in j + 1..N {
            let mut sum = s[i][j];
            for k in 0..j {
                sum -= l[i][k] * l[j][k];
            }
            l[i][j] = sum * inverse;
        }
    }
    Some(l)
}

/// X with (L Lᵀ) Xᵀ = Bᵀ, that is X = B (L Lᵀ)⁻¹.
#[inline]
pub(super) fn right_divide<const N: usize>(b: &Matrix<N>, l: &Matrix<N>) -> Matrix<N> {
    let inverse: Vector<N> = std::array::from_fn(|j| 1.0 / l[j][j]);
    let mut x = *b;
    for row in &mut x {
        for j in 0..N {
            for k in 0..j {
                row[j] -= l[j][k] * row[k];
            }
            row[j] *= inverse[j];
        }
        for j in (0..N).rev() {
            for k in j + 1..N {
                row[j] -= l[k][j] * row[k];
            }
            row[j] *= inverse[j];
        }
    }
    x
}

/// A⁻¹ by Gauss-Jordan with row pivoting; `None` for a singular matrix.
pub(super) fn inverse<const N: usize>(a: &Matrix<N>) -> Option<Matrix<N>> {
    let mut a = *a;
    let mut x = identity::<N>();
    for j in 0..N {
        let mut best = j;
        for i in j..N {
            if a[i][j].abs() > a[best][j].abs() {
                best = i;
            }
        }
        if a[best][j] == 0.0 || a[best][j].is_nan() {
            return None;
        }
        a.swap(j, best);
        x.swap(j, best);
        let scale = 1.0 / a[j][j];
        for k in 0..N {
            a[j][k] *= scale;
            x[j][k] *= scale;
        }
        for i in 0..N {
            if i != j {
                let factor = a[i][j];
                for k in 0..N {
                    a[i][k] -= factor * a[j][k];
                    x[i][k] -= factor * x[j][k];
                }
            }
        }
    }
    Some(x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn factor_divide_and_invert() {
        let s = [[4.0, 2.0, 0.4], [2.0, 5.0, 1.0], [0.4, 1.0, 3.0]];
        let l = cholesky(&s, 0.0).unwrap();
        let back = congruence(&l, &identity());
        let one = right_divide(&s, &l);
        let also_one = product(&s, &inverse(&s).unwrap());
        for i in 0..3 {
            for j in 0..3 {
                assert!((back[i][j] - s[i][j]).abs() < 1e-15);
                let expected = f64::from(i == j);
                assert!((one[i][j] - expected).abs() < 1e-15);
                assert!((also_one[i][j] - expected).abs() < 1e-15);
            }
        }
        assert!(cholesky(&[[1.0, 1.0], [1.0, 1.0]], 1e-12).is_none());
        assert!(inverse(&[[0.0, 0.0], [0.0, 1.0]]).is_none());
    }
}
