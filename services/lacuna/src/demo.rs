//! `lacuna demo`: the paper's experiment on a simulated robot, through the real process graph.
//!
//! Thirteen free motions and a pick-and-place with 3.8 kg are simulated; the model is identified from twelve of the
//! free motions; the thirteenth (v_F) and the pick-and-place (v_P) are replayed through the graph; and the paper's
//! two tables are computed from what the graph recorded.

use crate::CommandResult;
use crate::progress::Progress;
use crate::recorded::{Recorded, Series};
use crate::words::{cannot_write, line};
use clap::Args;
use lacuna_identify::payload::{Moments, SETTLED};
use lacuna_identify::{Method, Options, Outcome};
use lacuna_report::{JointTrace, NamedSeries, OverlayPicture, TorqueTrace, overlay_svg};
use lacuna_simulate::demo::{DEMO_PAYLOAD_KG, DEMO_ROBOT};
use lacuna_simulate::{Demo, EventTruth, demo_delta, write_csv};
use lacuna_stage::{Failure, HopLatency};
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};

/// Speed above which a sample counts as moving [rad/s]: below it Coulomb friction is indeterminate.
const MOVING: f64 = 0.05;
/// Seconds of the live run that the latencies come from.
const LIVE_S: f64 = 6.0;

#[derive(Args)]
pub struct DemoArgs {
    /// Folder for recordings, models and results.
    #[arg(long, default_value = "recordings/demo")]
    out: PathBuf,
    /// Folder of the launch files.
    #[arg(long, default_value = "launch")]
    launch: PathBuf,
    /// Seed of the simulated robot.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Also draw measured and model torque as SVG.
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
}

/// `lacuna demo`.
pub fn demo(args: &DemoArgs) -> CommandResult {
    let progress = Progress::spinner();
    progress.step("simulating 13 free motions and a pick-and-place with 3.8 kg");
    let demo = demo_delta(args.seed)?;
    let files = Files::write(&args.out, &demo)?;

    progress.step("identifying ρ1, ρ2 and friction from 12 motions, as in the paper");
    let paper = identify(&files, Method::Paper)?;
    std::fs::write(&files.model, paper.model.to_toml()?).map_err(|e| cannot_write(&files.model, &e))?;
    progress.step("identifying all base parameters from the same motions");
    let ours = identify(&files, Method::Pooled)?;

    progress.step("replaying v_F through the graph");
    up(args, &files, "replay.toml", &files.test, &files.mcap("v_f.mcap"), 0.0)?;
    progress.step("replaying v_P through the graph");
    let replay = up(args, &files, "replay.toml", &files.pick_place, &files.mcap("v_p.mcap"), 0.0)?;
    progress.step("running v_P live at recorded speed, for the latencies");
    let live = up(args, &files, "live.toml", &files.short, &files.mcap("live.mcap"), 1.0)?;
    drop(progress);

    let free = Recorded::read(&files.mcap("v_f.mcap"))?;
    let carried = Recorded::read(&files.mcap("v_p.mcap"))?;
    let events = demo.pick_place.truth.events.values().next().cloned().unwrap_or_default();
    print_table_1(&free, &paper, &ours)?;
    print_table_2(&carried)?;
    print_payload(&carried, &events)?;
    print_run(&replay, &live)?;
    if let Some(path) = &args.picture {
        draw(&free, path)?;
        line(format_args!("\nPicture: {}", path.display()))?;
    }
    line(format_args!("\nRecordings: {} and {}", files.mcap("v_f.mcap").display(), files.mcap("v_p.mcap").display()))?;
    line(format_args!(
        "Open them in Foxglove or Lichtblick (open local file), in PlotJuggler (drag and drop), or with `rerun FILE`;"
    ))?;
    line(format_args!(
        "plot /measured, /torque/nominal, /torque/rigid, /friction, /residual by joint name, and /payload."
    ))?;
    Ok(ExitCode::SUCCESS)
}

struct Files {
    robot: PathBuf,
    training: Vec<PathBuf>,
    test: PathBuf,
    pick_place: PathBuf,
    short: PathBuf,
    model: PathBuf,
    out: PathBuf,
}

impl Files {
    fn write(out: &Path, demo: &Demo) -> Result<Self, Failure> {
        std::fs::create_dir_all(out).map_err(|e| cannot_write(out, &e))?;
        let files = Self {
            robot: out.join("robot.toml"),
            training: (1..=demo.training_motions().len()).map(|i| out.join(format!("free_{i:02}.csv"))).collect(),
            test: out.join("v_f.csv"),
            pick_place: out.join("v_p.csv"),
            short: out.join("v_p_start.csv"),
            model: out.join("model.toml"),
            out: out.to_path_buf(),
        };
        std::fs::write(&files.robot, DEMO_ROBOT).map_err(|e| cannot_write(&files.robot, &e))?;
        let test = demo.test_motion().ok_or_else(|| Failure::run("the simulation gave no motion"))?;
        let carried =
            demo.pick_place.recordings.first().ok_or_else(|| Failure::run("the simulation gave no pick-and-place"))?;
        let mut start = carried.clone();
        let keep = carried.t_s.iter().take_while(|t| **t < carried.t_s[0] + LIVE_S).count();
        start.t_s.truncate(keep);
        start.q_rad.iter_mut().chain(&mut start.tau_nm).chain(start.extra.values_mut()).for_each(|c| c.truncate(keep));
        let all = files.training.iter().zip(demo.training_motions());
        for (path, recording) in all.chain([(&files.test, test), (&files.pick_place, carried), (&files.short, &start)])
        {
            let file = std::fs::File::create(path).map_err(|e| cannot_write(path, &e))?;
            let mut out = std::io::BufWriter::new(file);
            write_csv(recording, &mut out).and_then(|()| out.flush()).map_err(|e| cannot_write(path, &e))?;
        }
        Ok(files)
    }

    fn mcap(&self, name: &str) -> PathBuf {
        self.out.join(name)
    }
}

fn identify(files: &Files, method: Method) -> Result<Outcome, Failure> {
    let range = |path: &PathBuf| lacuna_identify::FileRange { file: path.clone(), from_s: None, to_s: None };
    let options = Options {
        robot: files.robot.clone(),
        train: files.training.iter().map(range).collect(),
        test: vec![range(&files.test)],
        method,
        ..Options::default()
    };
    Ok(lacuna_identify::identify(&options, &mut |_, _| ())?)
}

/// Runs a graph with this very executable and returns its report.
fn up(
    args: &DemoArgs,
    files: &Files,
    graph: &str,
    recording: &Path,
    out: &Path,
    rate: f64,
) -> Result<serde_json::Value, Failure> {
    let own = std::env::current_exe().map_err(|e| Failure::run(format!("own executable: {e}")))?;
    let mut command = Command::new(own);
    command.arg("up").arg(args.launch.join(graph)).arg("--json");
    let paths = [("recording", recording), ("robot", &files.robot), ("model", &files.model), ("out", out)];
    for (key, path) in paths {
        command.arg("--set").arg(format!("{key}={}", path.display()));
    }
    command.args(["--set", "overwrite=true"]);
    if rate > 0.0 {
        command.arg("--set").arg(format!("rate={rate}"));
    }
    let done = command.stdin(Stdio::null()).output().map_err(|e| Failure::run(format!("lacuna up: {e}")))?;
    let words = String::from_utf8_lossy(&done.stderr);
    // Live edges may drop under load; the report says so, and the latencies are still of use.
    if !matches!(done.status.code(), Some(0 | 3)) {
        return Err(Failure::run(words.trim().trim_start_matches("lacuna: ").to_owned()));
    }
    serde_json::from_slice(&done.stdout).map_err(|e| Failure::run(format!("lacuna up {graph}: unreadable report: {e}")))
}

/// Mean and standard deviation over the moving samples of each joint.
fn moments(recorded: &Recorded, error: impl Fn(usize, usize) -> f64) -> Vec<(f64, f64)> {
    let joints = recorded.velocity.values.first().map_or(0, Vec::len);
    let mut moments = Moments::new(joints);
    for (k, velocity) in recorded.velocity.values.iter().enumerate() {
        (0..joints).filter(|&j| velocity[j].abs() > MOVING).for_each(|j| moments.add(j, error(k, j)));
    }
    let table = moments.table("");
    table.mean_nm.into_iter().zip(table.std_nm).collect()
}

/// The streams of a recording, all of one length.
fn streams<'a, const N: usize>(recorded: &'a Recorded, topics: [&str; N]) -> Result<[&'a Series; N], Failure> {
    let mut found = Vec::new();
    for topic in topics {
        let series = recorded.effort(topic)?;
        if series.values.len() != recorded.velocity.values.len() {
            return Err(Failure::run(format!(
                "{topic} has {} samples, /smoothed has {}",
                series.values.len(),
                recorded.velocity.values.len()
            )));
        }
        found.push(series);
    }
    found.try_into().map_err(|_| Failure::run("streams"))
}

fn print_row(name: &str, columns: &[Vec<(f64, f64)>], joint: usize) -> Result<(), Failure> {
    let mut row = format!("  {name:<6}");
    for column in columns {
        let (mean, sd) = column.get(joint).copied().unwrap_or((f64::NAN, f64::NAN));
        // Writing to a String cannot fail.
        let _ = write!(row, "  {mean:>8.2} {sd:>8.2}");
    }
    line(format_args!("{row}"))
}

fn print_table_1(free: &Recorded, paper: &Outcome, ours: &Outcome) -> Result<(), Failure> {
    let [measured, nominal, rigid, friction] =
        streams(free, ["/measured", "/torque/nominal", "/torque/rigid", "/friction"])?;
    let columns = [
        moments(free, |k, j| measured.values[k][j] - nominal.values[k][j]),
        moments(free, |k, j| measured.values[k][j] - rigid.values[k][j]),
        moments(free, |k, j| measured.values[k][j] - rigid.values[k][j] - friction.values[k][j]),
    ];
    line(format_args!(
        "Table 1. Torque error over v_F, a free motion not used for identification (Nm, moving samples)"
    ))?;
    line(format_args!("  {:<6}  {:^17}  {:^17}  {:^17}", "", "M_KH", "M_Id", "M_Id+F"))?;
    line(format_args!("  {:<6}  {:>8} {:>8}  {:>8} {:>8}  {:>8} {:>8}", "", "μ", "σ", "μ", "σ", "μ", "σ"))?;
    for j in 0..columns[0].len() {
        print_row(&format!("τ{}", j + 1), &columns, j)?;
    }
    if let Some(p) = &paper.identification.paper {
        line(format_args!(
            "  ρ1 = {:.3}, ρ2 = {:.3}; f_v = {:.2?} Nm s/rad; f_c = {:.2?} Nm",
            p.rho1, p.rho2, p.f_v, p.f_c
        ))?;
    }
    let sd = |o: &Outcome| {
        o.identification.held_out.score.std_nm.iter().map(|v| format!("{v:.2}")).collect::<Vec<_>>().join(", ")
    };
    line(format_args!(
        "  Offline on the same motion, σ per joint: paper's method {} Nm; all base parameters fitted together {} Nm.",
        sd(paper),
        sd(ours)
    ))?;
    Ok(())
}

fn print_table_2(carried: &Recorded) -> Result<(), Failure> {
    let [without, with] = streams(carried, ["/residual", "/residual_payload"])?;
    let columns = [moments(carried, |k, j| without.values[k][j]), moments(carried, |k, j| with.values[k][j])];
    line(format_args!(
        "\nTable 2. Torque error of M_Id+F over v_P, pick-and-place with {DEMO_PAYLOAD_KG} kg (Nm, moving samples)"
    ))?;
    line(format_args!("  {:<6}  {:^17}  {:^17}", "", "m_p = 0", "m_p = m̂_p"))?;
    line(format_args!("  {:<6}  {:>8} {:>8}  {:>8} {:>8}", "", "μ", "σ", "μ", "σ"))?;
    for j in 0..columns[0].len() {
        print_row(&format!("τ{}", j + 1), &columns, j)?;
    }
    Ok(())
}

/// How long after `from` the estimate stays within `tolerance` of `mass` for good (until `until`), and its mean then.
fn settling(payload: &Series, from: f64, until: f64, mass: f64, tolerance: f64) -> Option<(f64, f64)> {
    let inside: Vec<(f64, f64)> = payload
        .t_s
        .iter()
        .zip(&payload.values)
        .filter(|(t, v)| **t >= from && **t < until && v[2] > 0.0)
        .map(|(t, v)| (*t, v[0]))
        .collect();
    lacuna_identify::payload::settling(&inside, from, mass, tolerance)
}

fn print_payload(carried: &Recorded, events: &[EventTruth]) -> Result<(), Failure> {
    line(format_args!(
        "\nPayload m̂_p (settled: within {:.0} % of the true mass, or of zero, until the next event)",
        SETTLED * 100.0
    ))?;
    let end = carried.payload.t_s.last().copied().unwrap_or(0.0);
    for (i, event) in events.iter().enumerate() {
        let next = events.get(i + 1).map_or(end, |e| e.t_on);
        let tolerance = SETTLED * event.mass;
        match settling(&carried.payload, event.t_on, event.t_off, event.mass, tolerance) {
            Some((s, m)) => line(format_args!(
                "  pick  at {:6.3} s: settled after {s:.3} s at {m:.3} kg, error {:+.1} %",
                event.t_on,
                (m / event.mass - 1.0) * 100.0
            ))?,
            None => line(format_args!("  pick  at {:6.3} s: not settled before the place", event.t_on))?,
        }
        match settling(&carried.payload, event.t_off, next, 0.0, tolerance) {
            Some((s, m)) => line(format_args!("  place at {:6.3} s: zero after {s:.3} s, {m:+.3} kg", event.t_off))?,
            None => line(format_args!("  place at {:6.3} s: not back to zero before the next pick", event.t_off))?,
        }
    }
    Ok(())
}

fn print_run(replay: &serde_json::Value, live: &serde_json::Value) -> Result<(), Failure> {
    let rate = replay["samples"].as_f64().unwrap_or(0.0) / replay["seconds"].as_f64().unwrap_or(f64::NAN);
    line(format_args!(
        "\nGraph: 7 processes, replay of v_P at {:.0} samples/s including start and end, {} lost",
        rate, replay["lost"]
    ))?;
    line(format_args!(
        "Live at 1 kHz, latency per hop (µs)           p50       p99     p99.9       max    {} lost",
        live["lost"]
    ))?;
    let names = ["source", "smoother", "torque", "friction", "payload", "monitor", "recorder"].map(str::to_owned);
    let hops: Vec<HopLatency> =
        serde_json::from_value(live["nodes"]["recorder"]["latency"].clone()).unwrap_or_default();
    for hop in hops {
        let label = lacuna_benches::latency::named(&hop.hop, &names);
        line(format_args!(
            "  {label:<38} {:>9.1} {:>9.1} {:>9.1} {:>9.1}",
            hop.p50_us, hop.p99_us, hop.p999_us, hop.max_us
        ))?;
    }
    Ok(())
}

fn draw(free: &Recorded, path: &Path) -> Result<(), Failure> {
    let [measured, nominal, rigid, friction] =
        streams(free, ["/measured", "/torque/nominal", "/torque/rigid", "/friction"])?;
    let column = |s: &Series, j: usize| s.values.iter().map(|v| v[j]).collect::<Vec<f64>>();
    let joints = (0..measured.values.first().map_or(0, Vec::len))
        .map(|j| {
            let full = column(rigid, j).iter().zip(column(friction, j)).map(|(a, b)| a + b).collect();
            let series = |name: &str, values| NamedSeries { name: name.to_owned(), values };
            JointTrace {
                joint: format!("τ{}", j + 1),
                measured: column(measured, j),
                models: vec![
                    series("M_KH", column(nominal, j)),
                    series("M_Id", column(rigid, j)),
                    series("M_Id+F", full),
                ],
                ..JointTrace::default()
            }
        })
        .collect();
    let trace = TorqueTrace { recording: "v_F".to_owned(), t_s: measured.t_s.clone(), joints };
    let picture = OverlayPicture {
        title: "Torque of a free motion the model has not seen: measured (grey) and modelled",
        torque_unit: "Nm",
        trace: &trace,
        window_s: Some((1.0, 4.0)),
    };
    std::fs::write(path, overlay_svg(&picture)).map_err(|e| cannot_write(path, &e))
}
