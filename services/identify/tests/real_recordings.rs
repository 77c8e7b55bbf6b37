//! The figures to reach on real recordings.
mod common;
use common::{files, options, part, shared, whole};
use lacuna_identify::{Outcome, Signal, identify};

fn run(options: &lacuna_identify::Options) -> Outcome {
    identify(options, &mut |_, _| ()).unwrap()
}
fn show(name: &str, o: &Outcome) {
    let i = &o.identification;
    eprintln!("{name}: RE {:.4} per joint {:.3?} folds {:.3?} still {:?} nominal {:?} cond {:?} delay {:?} blocks {} not_excited {} outl {:.2?}", i.held_out.score.relative_error, i.held_out.score.relative_error_per_joint, i.held_out.folds, i.held_out.with_standstill, i.held_out.nominal_relative_error, i.condition_numbers, i.delay, i.blocks, i.not_excited.len(), i.outlier_share);
    for w in &i.warnings { eprintln!("   ! {w}"); }
    for r in &i.repairs { eprintln!("   r {r:?}"); }
    for p in &i.parameters { eprintln!("   {} = {:.5} [{:.5} {:.5}] {} nominal {:?} {:?}", p.symbol, p.value, p.ci95[0], p.ci95[1], p.unit, p.nominal, p.merged_with.iter().map(|m| format!("{:+.4} {}", m.factor, m.symbol)).collect::<Vec<_>>().join(" ")); }
    for p in &i.not_excited { eprintln!("   - {}: {}", p.symbol, p.reason); }
}

#[test]
fn double_pendulum() {
    let Some(dir) = shared("dfki_double_pendulum") else { return };
    let file = files(&dir, "061157").remove(0);
    for (a, b) in [((0.0, 36.6), (36.6, 80.0)), ((36.6, 80.0), (0.0, 36.6))] {
        let mut o = options(&dir, 8.0);
        o.train = vec![part(&file, a.0, a.1)];
        o.test = vec![part(&file, b.0, b.1)];
        show("dp", &run(&o));
        o.robust = false;
        o.delay = lacuna_identify::Delay::Off;
        eprintln!("  plain {:.4}", run(&o).identification.held_out.score.relative_error);
    }
}

#[test]
fn tx40() {
    let Some(dir) = shared("staubli_tx40") else { return };
    let file = dir.join("tx40_traj.csv");
    let mut o = options(&dir, 50.0);
    o.conditioning.moving_rad_s = 0.0;
    o.train = vec![part(&file, 0.0, 5.4)];
    o.test = vec![part(&file, 5.5, 8.9)];
    show("tx40", &run(&o));
    o.robust = false;
    o.delay = lacuna_identify::Delay::Off;
    eprintln!("  plain {:.4}", run(&o).identification.held_out.score.relative_error);
    let mut o = options(&dir, 50.0);
    o.recordings = vec![file];
    show("tx40 all moving", &run(&o));
}

#[test]
fn kuka() {
    let Some(dir) = shared("kuka_kr300") else { return };
    let mut o = options(&dir, 8.0);
    o.conditioning.cut_s = Some(0.3);
    o.train = vec![whole(dir.join("traj_A.csv")), whole(dir.join("traj_B.csv"))];
    o.test = vec![whole(dir.join("traj_C.csv"))];
    show("kuka", &run(&o));
    o.robust = false;
    o.delay = lacuna_identify::Delay::Off;
    eprintln!("  plain {:.4}", run(&o).identification.held_out.score.relative_error);
}

#[test]
fn xl330() {
    let Some(dir) = shared("bam_xl330") else { return };
    let mut o = options(&dir, 15.0);
    o.conditioning.moving_rad_s = 0.25;
    o.train = files(&dir, "").into_iter().filter(|f| !f.to_str().unwrap().contains("kp200")).map(whole).collect();
    o.test = files(&dir, "kp200").into_iter().map(whole).collect();
    show("xl330", &run(&o));
    o.robust = false;
    o.delay = lacuna_identify::Delay::Off;
    eprintln!("  plain {:.4}", run(&o).identification.held_out.score.relative_error);
}

#[test]
fn kinova() {
    let Some(dir) = shared("kinova_gen3") else { return };
    let mut o = options(&dir, 12.0);
    o.signal = Signal::MotorMinusLink;
    o.recordings = files(&dir, "");
    show("kinova", &run(&o));
}

#[test]
fn delta() {
    let Some(dir) = shared("delta_concealed") else { return };
    for case in ["09000", "09001", "09002"] {
        let dir = dir.join(format!("cases/case_{case}"));
        let mut o = options(&dir, 40.0);
        o.recordings = files(&dir, "traj");
        let t = std::time::Instant::now();
        let out = run(&o);
        eprintln!("{:?}", t.elapsed());
        show("delta", &out);
        eprintln!("rms {:.4?}", out.identification.held_out.score.rms_nm);
    }
}
