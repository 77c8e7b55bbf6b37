//! Writes the demo's recordings: `cargo run --release -p lacuna-simulate --example simulate_demo -- FOLDER [SEED]`.

use lacuna_simulate::demo::{DEMO_ROBOT, demo_delta};
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let folder = PathBuf::from(args.next().ok_or("usage: simulate_demo FOLDER [SEED]")?);
    let seed = args.next().map_or(Ok(1), |s| s.parse())?;
    let clock = std::time::Instant::now();
    let demo = demo_delta(seed)?;
    let simulated: f64 = demo.free.recordings.iter().chain(&demo.pick_place.recordings).map(|r| r.duration_s()).sum();
    println!("{simulated:.0} s of recordings simulated in {:.2} s", clock.elapsed().as_secs_f64());
    for (name, part) in [("free", &demo.free), ("pick_place", &demo.pick_place)] {
        part.write(&folder.join(name))?;
        std::fs::write(folder.join(format!("{name}.truth.json")), part.truth.to_json()?)?;
        println!(
            "{name}: hidden torque {:.2?} Nm RMS, tracking error {:.1e} rad",
            part.truth.hidden_rms_nm, part.truth.tracking_error_rad
        );
    }
    std::fs::write(folder.join("robot.toml"), DEMO_ROBOT)?;
    Ok(())
}
