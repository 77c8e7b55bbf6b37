//! Draws one case per effect and prints what it does to the recordings:
//! `cargo run --release -p lacuna-simulate --example survey -- [delta|serial] [SEED]`.

use lacuna_interfaces::robot::Kind;
use lacuna_simulate::case::{CaseOptions, draw_case, drawable};
use lacuna_simulate::simulate;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let kind = if args.next().as_deref() == Some("serial") { Kind::Serial } else { Kind::Delta };
    let seed: u64 = args.next().map_or(Ok(1), |s| s.parse())?;
    for (k, (id, _)) in drawable(kind).into_iter().enumerate() {
        let options = CaseOptions {
            kind,
            ids: vec![id.to_owned()],
            severity: [1.0, 1.0],
            measure_effects: true,
            ..CaseOptions::default()
        };
        let clock = std::time::Instant::now();
        let case = draw_case(seed + k as u64, &options)?;
        match simulate(&case.robot, None, &case.config) {
            Ok(s) => println!(
                "{id:18} {:?} effect {:.2?} hidden {:.1?} oracle {:.3?} (40 Hz {:.3?}) noise {:.2?} track {:.0e} {:.2} s",
                case.config.effects[0].joints,
                s.truth.effects[0].rms_nm,
                s.truth.hidden_rms_nm,
                s.truth.oracle.from_csv_rms,
                s.truth.oracle.from_csv_rms_40hz,
                s.truth.noise.torque_nm,
                s.truth.tracking_error_rad,
                clock.elapsed().as_secs_f64()
            ),
            Err(e) => println!("{id:18} {e}"),
        }
    }
    Ok(())
}
