//! False alarms on clean recordings, and alarms on effects, through all stages with identified models.

mod common;

use common::{Identified, onsets, watch};
use rayon::prelude::*;

#[test]
#[ignore = "exploration"]
fn explore() {
    let robots: u64 = std::env::var("ROBOTS").map_or(4, |v| v.parse().unwrap());
    let seconds: f64 = std::env::var("SECONDS_EACH").map_or(120.0, |v| v.parse().unwrap());
    let rows: Vec<String> = (1..=robots).into_par_iter().map(|seed| {
        let id = Identified::new(seed);
        let samples = id.residuals(&id.recordings(seconds, &[]));
        let hours = samples.len() as f64 * 1e-3 / 3600.0;
        let mut text = format!("robot {seed}: sd {:.3?} n {}", &id.model.noise.sd_tau_nm, samples.len());
        for (rate, model) in [(0.1, 0.0), (1.0, 0.0), (10.0, 0.0), (100.0, 0.0), (0.1, 0.005), (1.0, 0.005), (10.0, 0.005), (100.0, 0.005)] {
            let out = watch(&mut id.monitor(&format!("false_alarms_per_hour = {rate:?}\nmodel_error = {model:?}")), &samples);
            let on = onsets(&out);
            text += &format!("\n   rate {rate} {model}: {on} alarms in {hours:.3} h, expected {:.2}; block sd {:.3?}; max score {:.2}", rate * hours,
                &out.last().unwrap().sd_nm[..3],
                out.iter().flat_map(|o| o.score[..3].to_vec()).fold(0.0, f64::max));
        }
        text
    }).collect();
    rows.iter().for_each(|r| println!("{r}"));
}
