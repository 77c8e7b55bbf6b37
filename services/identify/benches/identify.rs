//! A quarter of a million, one million and four million samples of a Delta, as a user has them identified: repair,
//! smoothing, regressor, filters, weighted robust fit, intervals, held-out error, account. The memory is what the process
//! takes at its peak beyond the recording that it is given. Beside it numpy's `lstsq`, on the rows that the fit of a
//! million samples uses, if a Python with numpy is at hand (`LACUNA_PYTHON`, else `python3`).
//!
//! `cargo bench -p lacuna-identify`

use lacuna_identify::base::structure;
use lacuna_identify::columns::columns;
use lacuna_identify::condition::Conditioning;
use lacuna_identify::rows::{Rows, rows};
use lacuna_identify::split::Span;
use lacuna_identify::{Options, Signal, identify_recordings};
use lacuna_interfaces::{Recording, RobotFile};
use lacuna_physics::{Motion, RigidBody};
use std::io::Write;
use std::time::Instant;

const ROBOT: &str = "kind = \"delta\"\nname = \"bench\"\n[geometry]\nl1 = 0.35\nl2 = 0.88\nra = 0.2\nrb = 0.05\n[mass]\n\
    platform = 1.1\nupper_arm = 1.8\nforearm_point = 0.22\nrotor_inertia = 0.06\n";

/// `samples` at 1 kHz of a sum of sines per joint, with friction and noise.
fn recording(robot: &RobotFile, body: &dyn RigidBody, samples: usize) -> Recording {
    let nominal = body.nominal();
    let mut out = Recording {
        name: "bench.csv".to_owned(),
        joints: robot.joints.clone(),
        q_rad: vec![Vec::new(); 3],
        tau_nm: vec![Vec::new(); 3],
        ..Recording::default()
    };
    let mut state = 0x2545_f491_4f6c_dd1d_u64;
    let mut noise = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
    };
    let mut tau = [0.0; 3];
    for k in 0..samples {
        let t = k as f64 * 1e-3;
        let (mut q, mut qd, mut qdd) = ([0.2; 3], [0.0; 3], [0.0; 3]);
        for j in 0..3 {
            for (h, amplitude) in [(1.0, 0.25), (2.3, 0.1), (5.1, 0.03)] {
                let w = (2.0 + 0.37 * j as f64) * h;
                let (s, c) = (w * t + j as f64).sin_cos();
                q[j] += amplitude * s;
                qd[j] += amplitude * w * c;
                qdd[j] -= amplitude * w * w * s;
            }
        }
        let motion = Motion { q_rad: &q, qd_rad_s: &qd, qdd_rad_s2: &qdd };
        body.torque(&motion, &nominal, &mut tau).expect("the bench's motion is within reach");
        out.t_s.push(t);
        for j in 0..3 {
            out.q_rad[j].push(q[j] + 1e-6 * noise());
            out.tau_nm[j].push(tau[j] + 0.5 * qd[j] + 1.5 * qd[j].signum() + 0.3 * noise());
        }
    }
    out
}

/// Wall clock and the process's CPU time, which a busy machine does not stretch.
struct Clock {
    wall: Instant,
    cpu_s: f64,
}

impl Clock {
    fn now() -> Self {
        Self { wall: Instant::now(), cpu_s: cpu_s() }
    }

    fn lap(&self, label: &str) -> Self {
        let cpu = cpu_s() - self.cpu_s;
        println!("  {label:32} {:.3} s ({cpu:.2} s of CPU time)", self.wall.elapsed().as_secs_f64());
        Self::now()
    }
}

/// User and system time of this process [s], in hundredths (Linux); 0 elsewhere.
fn cpu_s() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // Fields 14 and 15, counted behind the command name's bracket.
    let fields = stat.rsplit(')').next().unwrap_or_default().split_whitespace().skip(11).take(2);
    fields.filter_map(|f| f.parse::<f64>().ok()).sum::<f64>() / 100.0
}

/// A line of /proc/self/status [MiB] (Linux); NaN elsewhere.
fn status_mib(key: &str) -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix(key)).unwrap_or_default();
    let kib = line.trim_start_matches(':').trim().trim_end_matches("kB").trim();
    kib.parse::<f64>().map_or(f64::NAN, |k| k / 1024.0)
}

fn main() {
    let robot = RobotFile::parse(ROBOT).expect("the bench's robot file");
    let body = lacuna_physics::build(&robot, None).expect("the bench's robot");
    for samples in [250_000, 1_000_000, 4_000_000] {
        let recording = recording(&robot, body.as_ref(), samples);
        println!("{samples} samples x 3 joints, 21 parameters, {} threads", rayon_threads());
        if samples == 1_000_000 {
            reference(&robot, body.as_ref(), &recording);
        }
        let ranges = (vec![Span::whole(0)], vec![Span::whole(0)]);
        // The peak so far is forgotten; where that is not allowed the figure is an upper bound.
        let _ = std::fs::write("/proc/self/clear_refs", "5");
        let before = status_mib("VmRSS");
        let start = Clock::now();
        let options = Options::default();
        let outcome = identify_recordings(&options, &robot, body.as_ref(), vec![recording], &ranges, &mut |_, _| ())
            .expect("identify");
        start.lap("identification");
        println!("  memory beyond the recording      {:.0} MiB", status_mib("VmHWM") - before);
        let i = &outcome.identification;
        println!("  {} rows in {} blocks; {} parameters", i.rows.iter().sum::<usize>(), i.blocks, i.parameters.len());
    }
}

/// numpy's lstsq on the rows of the fit.
fn reference(robot: &RobotFile, body: &dyn RigidBody, recording: &Recording) {
    let all = columns(body, Signal::Motor, "Nm");
    let structure = structure(body, robot, all).expect("structure");
    let plan = Conditioning::default().plan(&[recording]).expect("plan");
    let rows = rows(body, robot, &structure, &plan, std::slice::from_ref(recording)).expect("rows");
    numpy(&structure.active, structure.base.len(), &rows);
}

fn rayon_threads() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// Times numpy's lstsq on the same rows.
fn numpy(active: &[Vec<usize>], columns: usize, rows: &Rows) {
    let python = std::env::var("LACUNA_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let path = std::env::temp_dir().join(format!("lacuna-bench-{}.f64", std::process::id()));
    let mut file = std::io::BufWriter::new(std::fs::File::create(&path).expect("temporary file"));
    let mut count = 0usize;
    let mut line = vec![0.0; columns + 1];
    for (j, active) in active.iter().enumerate() {
        let joint = &rows.joints[j];
        for k in (0..rows.len()).filter(|&k| joint.fitted[k]) {
            line.fill(0.0);
            for (slot, &b) in active.iter().enumerate() {
                line[b] = joint.x[k * active.len() + slot];
            }
            line[columns] = joint.y[k];
            for v in &line {
                file.write_all(&v.to_le_bytes()).expect("temporary file");
            }
            count += 1;
        }
    }
    file.flush().expect("temporary file");
    let script = format!(
        "import numpy as np,time\na=np.fromfile('{}').reshape({count},{})\nx=np.ascontiguousarray(a[:,:-1]);y=a[:,-1].copy()\n\
         t=time.time();b=np.linalg.lstsq(x,y,rcond=None)[0];print('  numpy lstsq on the same rows     %.3f s'%(time.time()-t))",
        path.display(),
        columns + 1
    );
    let ran = std::process::Command::new(&python).args(["-c", &script]).status();
    if !ran.is_ok_and(|s| s.success()) {
        println!("  numpy is not at hand ({python}): no comparison");
    }
    // Nothing depends on the file any more; a failure to remove it costs disk space only.
    let _ = std::fs::remove_file(&path);
}
