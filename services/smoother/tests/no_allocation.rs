//! After `new` the stage does not allocate, the look at the first stretch included: a counting allocator.

use lacuna_interfaces::{JointMeasured, RobotFile, Stage, StageContext};
use lacuna_smoother::{Config, Smoother};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

thread_local! {
    // Per thread: the test harness allocates on its own.
    static COUNT: Cell<usize> = const { Cell::new(0) };
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
fn step_and_finish() {
    let robot = RobotFile::parse(
        "kind = \"delta\"\nname = \"d\"\n[geometry]\nl1 = 0.35\nl2 = 0.88\nra = 0.2\nrb = 0.05\n\
         [mass]\nplatform = 1.1\nupper_arm = 1.8\nforearm_point = 0.22\n",
    )
    .unwrap();
    for config in ["", "process_noise = \"auto\"", "model = \"constant_jerk\"\nlag_samples = 50", "period_s = 0.001"] {
        let config: Config = toml::from_str(config).unwrap();
        let mut stage = Smoother::new(config, &StageContext { robot: &robot, urdf: None, model: None }).unwrap();
        let mut emitted = 0u64;
        let before = COUNT.with(Cell::get);
        for k in 0..10_000i64 {
            let mut m = JointMeasured::default();
            m.header.seq = k as u64 + 1;
            // Jitter for a while, and a gap.
            let jitter = if (4000..6000).contains(&k) { (k * 7919) % 300_000 } else { 0 };
            m.header.stamp_ns = k * 1_000_000 + jitter + if k > 7000 { 1_000_000_000 } else { 0 };
            for j in 0..3 {
                m.q_rad[j] = (k as f64 * 5e-3 + j as f64).sin() + 1e-6 * ((k * 31) % 17) as f64;
            }
            stage.step(&m, &mut |_| emitted += 1);
        }
        stage.finish(&mut |_| emitted += 1);
        assert_eq!(COUNT.with(Cell::get), before, "allocations after new");
        assert_eq!(emitted, 10_000);
    }
}
