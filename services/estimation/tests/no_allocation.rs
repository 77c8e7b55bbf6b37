//! The stream does not allocate, whatever comes: a counting allocator.

use lacuna_estimation::kalman::{FixedLag, Lag, MotionModel, Noise, Settings, estimate_noise};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

thread_local! {
    // Per thread: the test harness allocates on its own.
    static COUNT: Cell<usize> = const { Cell::new(0) };
}

fn count() -> usize {
    COUNT.with(Cell::get)
}

struct Counting;

#[expect(unsafe_code, reason = "an allocator that counts can only be written so")]
// SAFETY: every call is passed to the system allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        COUNT.with(|c| c.set(c.get() + 1));
        // SAFETY: the caller's promise about `layout` is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: `pointer` came from `alloc` above with this `layout`.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn fixed_lag_smoother_and_noise_estimate() {
    for model in [MotionModel::ConstantAcceleration, MotionModel::ConstantJerk] {
        let noise = Noise::from_bandwidth(model, 60.0, 1e-5, 1e-3);
        let other = Noise { process: noise.process * 2.0, ..noise };
        let settings = Settings { gap_s: 0.05, ..Settings::new(model, vec![noise, other, noise]) };
        let finer = Settings { noise: vec![other, noise, Noise { process: 1.0, ..noise }], ..settings.clone() };
        let mut stream = FixedLag::new(&settings, Lag::Samples(25)).unwrap();
        let (mut stamp, mut sum, mut emitted) = (0i64, 0.0, 0usize);
        let before = count();
        for k in 0..20_000i64 {
            // Regular, jittered and regular again, with gaps; then other noise.
            stamp += match k {
                5000..10_000 => 800_000 + (k * 7919) % 400_000,
                _ if k % 3000 == 2999 => 1_000_000_000,
                _ => 1_000_000,
            };
            let q = (stamp as f64 * 6e-9).sin();
            let mut emit = |e: &lacuna_estimation::kalman::LagEstimate<'_>| {
                sum += e.joints[2].qdd;
                emitted += 1;
            };
            if k == 15_000 {
                stream.set(&finer, Lag::Samples(20), &mut emit).unwrap();
            }
            stream.push(stamp, &[q, 0.5 * q, -q], &mut emit);
        }
        stream.finish(&mut |_| emitted += 1);
        assert_eq!(count(), before, "allocations on the stream");
        assert_eq!(emitted, 20_000);
        assert!(sum.is_finite());

        let t: Vec<f64> = (0..500).map(|k| f64::from(k) * 1e-3).collect();
        let q: Vec<f64> = t.iter().enumerate().map(|(k, t)| t.sin() + 1e-6 * ((k * 7919) % 101) as f64).collect();
        let before = count();
        let found = estimate_noise(model, &t, &q, 1e-3, 0.1, None, 1e-9);
        assert_eq!(count(), before, "allocations of the noise estimate");
        assert!(found.is_ok());
    }
}
