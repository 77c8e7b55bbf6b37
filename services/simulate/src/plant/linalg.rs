//! Cholesky for the joint-space inertia matrix, at most 8 × 8.

use lacuna_interfaces::MAX_JOINTS;

/// A matrix over joints; the leading n × n part is in use.
pub type JointMatrix = [[f64; MAX_JOINTS]; MAX_JOINTS];

/// Inverse of the symmetric positive definite leading `n` × `n` part of `a`; `None` if it is not positive definite.
pub fn invert_spd(a: &JointMatrix, n: usize) -> Option<JointMatrix> {
    let mut l = JointMatrix::default();
    for i in 0..n {
        for j in 0..=i {
            let mut s = a[i][j];
            for k in 0..j {
                s -= l[i][k] * l[j][k];
            }
            if i == j {
                if !(s > 0.0 && s.is_finite()) {
                    return None;
                }
                l[i][i] = s.sqrt();
            } else {
                l[i][j] = s / l[j][j];
            }
        }
    }
    // L⁻¹ in place of L, then A⁻¹ = L⁻ᵀ L⁻¹.
    let mut w = JointMatrix::default();
    for j in 0..n {
        w[j][j] = 1.0 / l[j][j];
        for i in j + 1..n {
            let mut s = 0.0;
            for k in j..i {
                s -= l[i][k] * w[k][j];
            }
            w[i][j] = s / l[i][i];
        }
    }
    let mut inverse = JointMatrix::default();
    for i in 0..n {
        for j in 0..=i {
            let mut s = 0.0;
            for k in i..n {
                s += w[k][i] * w[k][j];
            }
            inverse[i][j] = s;
            inverse[j][i] = s;
        }
    }
    Some(inverse)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    #[test]
    fn inverse_times_matrix_is_identity() {
        let mut r = Random::new(3, 0);
        for n in 1..=MAX_JOINTS {
            let mut b = JointMatrix::default();
            b.iter_mut().take(n).for_each(|row| row.iter_mut().take(n).for_each(|v| *v = r.normal()));
            let mut a = JointMatrix::default();
            for i in 0..n {
                for j in 0..n {
                    a[i][j] = (0..n).map(|k| b[i][k] * b[j][k]).sum::<f64>() + if i == j { 0.1 } else { 0.0 };
                }
            }
            let inv = invert_spd(&a, n).unwrap();
            for i in 0..n {
                for j in 0..n {
                    let s: f64 = (0..n).map(|k| a[i][k] * inv[k][j]).sum();
                    assert!((s - f64::from(u8::from(i == j))).abs() < 1e-9, "n {n}");
                }
            }
        }
        assert!(invert_spd(&[[0.0; MAX_JOINTS]; MAX_JOINTS], 2).is_none());
    }
}
