//! Delta recordings of an independent simulator whose answers are known (the keys are read here only).

mod common;

use common::{files, options, shared};
use lacuna_identify::identify;

fn numbers(value: &serde_json::Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

#[test]
fn clean_cases_reach_the_oracle_and_cover_the_truth() {
    let Some(dir) = shared("delta_concealed") else { return };
    let (mut inside, mut all) = (0, 0);
    for case in ["09000", "09001", "09002"] {
        let folder = dir.join(format!("cases/case_{case}"));
        let key = std::fs::read_to_string(dir.join(format!("keys/case_{case}.json"))).unwrap();
        let key: serde_json::Value = serde_json::from_str(&key).unwrap();
        let oracle = numbers(&key["oracle"]["from_csv_rms_40Hz"]);
        let mut o = options(&folder, 40.0);
        o.recordings = files(&folder, "traj");
        let outcome = identify(&o, &mut |_, _| ()).unwrap();
        let i = &outcome.identification;
        let ratio: Vec<f64> = i.held_out.score.rms_nm.iter().zip(&oracle).map(|(a, b)| a / b).collect();
        eprintln!("case {case}: held-out residual / oracle {ratio:.3?}, bristles {:?}", i.bristle_rad);
        assert!(ratio.iter().all(|r| *r <= 1.2), "{ratio:?}");
        let fc = numbers(&key["base_params"]["fc"]);
        let fv = numbers(&key["base_params"]["fv"]);
        for p in &i.parameters {
            let joint = |list: &[f64]| list[p.symbol[p.symbol.len() - 1..].parse::<usize>().unwrap() - 1];
            let truth = match p.symbol.get(..3) {
                Some("f_c") => joint(&fc),
                Some("f_v") => joint(&fv),
                // These cases hide nothing but friction: the rest is the robot file's.
                _ => p.nominal.unwrap_or(0.0),
            };
            let hit = p.ci95[0] <= truth && truth <= p.ci95[1];
            inside += usize::from(hit);
            all += 1;
            let half = 0.5 * (p.ci95[1] - p.ci95[0]);
            eprintln!(
                "   {} = {:.5} ± {half:.5}, truth {truth:.5}{}",
                p.symbol,
                p.value,
                if hit { "" } else { "  outside" }
            );
            assert!((p.value - truth).abs() < 2.0 * half, "{}: not even near its interval", p.symbol);
        }
    }
    eprintln!("{inside} of {all} parameters within their 95 % intervals");
    // 95 % of 42 is 40; 36 is three standard deviations below.
    assert!(inside as f64 >= 0.86 * all as f64 && all >= 40);
}
