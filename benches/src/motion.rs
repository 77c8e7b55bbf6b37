//! Synthetic recordings for benchmarks: sines within a Delta's workspace, written as CSV.

use crate::BenchError;
use std::io::{BufWriter, Write};
use std::path::Path;

/// Robot file of the synthetic recordings.
pub const ROBOT: &str = "kind = \"delta\"\nname = \"bench-delta\"\n[geometry]\nl1 = 0.35\nl2 = 0.88\nra = 0.2\nrb = 0.05\n\
[mass]\nplatform = 1.1\nupper_arm = 1.8\nforearm_point = 0.22\nrotor_inertia = 0.06\n[drive]\ngear_ratio = 33\n\
encoder_bits = 20\nsample_rate_hz = 1000\n";

/// Model file of the synthetic recordings: grey box and friction, so that every stage has work to do.
pub const MODEL: &str = "schema = \"lacuna.model/1\"\nrobot = \"bench-delta\"\n[rigid_body]\nrho1 = 1.1\nrho2 = 1.05\n\
[friction]\nf_v = [0.5, 0.5, 0.5]\nf_c = [1.5, 1.5, 1.5]\n\
[noise]\nsd_tau_nm = [0.1, 0.1, 0.1]\n";

/// Joint position and torque of sample `k` at `rate_hz`.
pub fn sample(k: u64, rate_hz: f64) -> ([f64; 3], [f64; 3]) {
    let t = k as f64 / rate_hz;
    let mut q = [0.0; 3];
    let mut tau = [0.0; 3];
    for i in 0..3 {
        let w = std::f64::consts::TAU * (0.7 + 0.2 * i as f64);
        q[i] = 0.4 + 0.25 * (w * t + i as f64).sin();
        tau[i] = -5.0 + 4.0 * (w * t).cos();
    }
    (q, tau)
}

/// Writes `samples` rows.
///
/// # Errors
/// If the file cannot be written.
pub fn write_csv(path: &Path, samples: u64, rate_hz: f64) -> Result<(), BenchError> {
    let mut out = BufWriter::new(std::fs::File::create(path)?);
    writeln!(out, "t,q1,q2,q3,tau1,tau2,tau3")?;
    for k in 0..samples {
        let (q, tau) = sample(k, rate_hz);
        let t = k as f64 / rate_hz;
        writeln!(out, "{t:.6},{:.9},{:.9},{:.9},{:.4},{:.4},{:.4}", q[0], q[1], q[2], tau[0], tau[1], tau[2])?;
    }
    Ok(out.flush()?)
}
