//! Helpers of the process tests: graphs in a temporary folder, started with the real `lacuna` executable.
//!
//! The stand-in stages in `src/bin` show that any executable which speaks an edge's messages can take a box.

use lacuna_interfaces::RobotFile;
use lacuna_simulate::config::TrajectoryGroup;
use lacuna_simulate::demo::DEMO_ROBOT;
use lacuna_simulate::reference::Kinds;
use lacuna_simulate::{SimulationConfig, simulate, write_csv};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

/// (log time, bytes) of every message, by topic.
pub type Messages = BTreeMap<String, Vec<(u64, Vec<u8>)>>;

/// All messages of a recording, read with the `mcap` crate.
///
/// # Panics
/// If it is no MCAP file.
pub fn messages(path: &Path) -> Messages {
    let bytes = std::fs::read(path).expect("recording");
    let mut all = Messages::new();
    for message in mcap::MessageStream::new(&bytes).expect("an MCAP file") {
        let message = message.expect("a message");
        let entry = all.entry(message.channel.topic.clone()).or_default();
        entry.push((message.log_time, message.data.into_owned()));
    }
    all
}

/// A Python with what `probe` (a script's arguments) needs; without one the test says that it is skipped.
///
/// # Panics
/// If a Python was named but is unfit: a mistake in the set-up, not a reason to skip.
pub fn python(test: &str, probe: &[&str]) -> Option<PathBuf> {
    let Some(python) = std::env::var_os("LACUNA_TEST_PYTHON").map(PathBuf::from) else {
        eprintln!("SKIPPED: {test}: LACUNA_TEST_PYTHON names no Python");
        return None;
    };
    let out = Command::new(&python).args(probe).current_dir(workspace()).output().expect("Python starts");
    assert!(out.status.success(), "{}: {}", python.display(), String::from_utf8_lossy(&out.stderr));
    Some(python)
}

/// A tool that the test command's `--all` builds (`LACUNA_TEST_TOOLS`), else one on PATH.
pub fn tool(name: &str) -> Option<PathBuf> {
    let tools = std::env::var_os("LACUNA_TEST_TOOLS").map(|dir| PathBuf::from(dir).join("bin").join(name));
    let path = std::env::var_os("PATH").unwrap_or_default();
    tools.into_iter().chain(std::env::split_paths(&path).map(|dir| dir.join(name))).find(|p| p.is_file())
}

/// A small Delta robot for graphs that need none of its physics.
pub const ROBOT: &str = "kind = \"delta\"\nname = \"test-delta\"\n[geometry]\nl1 = 0.35\nl2 = 0.88\nra = 0.2\nrb = 0.05\n\
[mass]\nplatform = 1.1\nupper_arm = 1.8\nforearm_point = 0.22\nrotor_inertia = 0.06\n[drive]\ngear_ratio = 33\n\
encoder_bits = 20\nsample_rate_hz = 1000\n";

/// A model file for the demo's Delta, with friction and noise.
pub const MODEL: &str = "schema = \"lacuna.model/1\"\nrobot = \"D3-1200-class\"\n[rigid_body]\nrho1 = 1.1\nrho2 = 1.05\n\
[friction]\nf_v = [0.5, 0.5, 0.5]\nf_c = [1.5, 1.5, 1.5]\n[noise]\nsd_tau_nm = [0.5, 0.5, 0.5]\n";

/// Directory of the executables under test.
///
/// # Panics
/// If this test executable does not lie in a cargo target folder.
pub fn bin_dir() -> PathBuf {
    // target/release/deps/test-… → target/release
    let exe = std::env::current_exe().expect("own path");
    exe.parent().and_then(Path::parent).expect("a cargo target folder").to_path_buf()
}

/// An executable of the workspace.
///
/// # Panics
/// If it has not been built.
pub fn bin(name: &str) -> PathBuf {
    let path = bin_dir().join(name);
    assert!(path.is_file(), "{} is missing: run `cargo build --release --workspace --bins` first", path.display());
    path
}

/// Root of the workspace.
///
/// # Panics
/// Never in a checkout.
pub fn workspace() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("workspace root").to_path_buf()
}

/// Folder of the shared recordings, or `None` with a visible word if they are not there.
pub fn shared_data(test: &str) -> Option<PathBuf> {
    let dir = std::env::var_os("LACUNA_SHARED_DATA").map_or_else(|| workspace().join("../shared/data"), PathBuf::from);
    if dir.is_dir() {
        return Some(dir);
    }
    eprintln!("SKIPPED: {test}: no recordings at {}", dir.display());
    None
}

/// A graph of stand-in stages: source → relays → sink.
#[derive(Debug, Clone)]
pub struct Chain {
    /// `replay` or `live`.
    pub mode: &'static str,
    /// Messages per edge.
    pub buffer: usize,
    /// Number of relays.
    pub relays: usize,
    /// Samples.
    pub samples: u64,
    /// Rate of the source [Hz], if it is paced.
    pub paced_hz: Option<f64>,
    /// Config of the sink.
    pub sink: &'static str,
    /// Restart policy of the relays.
    pub restart: &'static str,
}

impl Default for Chain {
    fn default() -> Self {
        Self { mode: "replay", buffer: 512, relays: 3, samples: 50_000, paced_hz: None, sink: "", restart: "never" }
    }
}

impl Chain {
    /// The graph file's text; `relay` gives the executable of relay i.
    pub fn toml(&self, relay: impl Fn(usize) -> String) -> String {
        let rate = self.paced_hz.unwrap_or(1000.0);
        let mut text = format!(
            "name = \"chain\"\nmode = \"{}\"\nrobot = \"robot.toml\"\nbuffer = {}\n\
             [[node]]\nname = \"source\"\nexec = \"lacuna-test-source\"\noutput = \"t0\"\n\
             config = {{ samples = {}, rate_hz = {rate:?}, paced = {} }}\n",
            self.mode,
            self.buffer,
            self.samples,
            self.paced_hz.is_some()
        );
        for i in 0..self.relays {
            text += &format!(
                "[[node]]\nname = \"relay{i}\"\nexec = \"{}\"\ninputs = [\"t{i}\"]\noutput = \"t{}\"\nrestart = \"{}\"\n",
                relay(i),
                i + 1,
                self.restart
            );
        }
        text + &format!(
            "[[node]]\nname = \"sink\"\nexec = \"lacuna-test-sink\"\ninputs = [\"t{}\"]\nconfig = {{ {} }}\n",
            self.relays, self.sink
        )
    }
}

/// A folder with a graph and what it needs.
pub struct Bench {
    dir: tempfile::TempDir,
}

impl Default for Bench {
    fn default() -> Self {
        Self::new()
    }
}

impl Bench {
    /// A fresh folder with `robot.toml`.
    ///
    /// # Panics
    /// If the temporary folder cannot be written.
    pub fn new() -> Self {
        let dir = tempfile::tempdir().expect("temporary folder");
        std::fs::write(dir.path().join("robot.toml"), ROBOT).expect("robot file");
        Self { dir }
    }

    /// A fresh folder with `robot.toml` and `model.toml` of the demo's Delta, and `run.csv`: pick-and-place of `seconds`.
    ///
    /// # Panics
    /// If the simulation fails or the folder cannot be written.
    pub fn with_motion(seconds: f64) -> Self {
        let bench = Self::new();
        bench.write("robot.toml", DEMO_ROBOT);
        bench.write("model.toml", MODEL);
        let robot = RobotFile::parse(DEMO_ROBOT).expect("robot");
        let group = TrajectoryGroup { kind: Kinds::PickPlace, duration_s: seconds, count: 1, intensity: 0.6 };
        let config = SimulationConfig { trajectories: vec![group], ..SimulationConfig::default() };
        let simulation = simulate(&robot, None, &config).expect("simulation");
        let mut csv = Vec::new();
        write_csv(&simulation.recordings[0], &mut csv).expect("csv");
        bench.write("run.csv", &String::from_utf8(csv).expect("text"));
        bench
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        self.dir.path()
    }

    /// Writes a file.
    ///
    /// # Panics
    /// If it cannot be written.
    pub fn write(&self, name: &str, text: &str) -> PathBuf {
        let path = self.dir.path().join(name);
        std::fs::write(&path, text).expect("test file");
        path
    }

    /// `lacuna ARGS` in this folder, to its end.
    ///
    /// # Panics
    /// If it cannot be started.
    pub fn lacuna(&self, args: &[&str]) -> Output {
        Command::new(bin("lacuna")).args(args).current_dir(self.path()).output().expect("lacuna starts")
    }

    /// `lacuna up GRAPH --json ARGS` in the background.
    ///
    /// # Panics
    /// If it cannot be started.
    pub fn up(&self, graph: &str, args: &[&str]) -> Running {
        let child = Command::new(bin("lacuna"))
            .args(["up", graph, "--json"])
            .args(args)
            .current_dir(self.path())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("lacuna starts");
        Running { child }
    }
}

/// A run in the background.
pub struct Running {
    /// The supervisor.
    pub child: Child,
}

impl Running {
    /// Name of the run, once its status file says it is running.
    ///
    /// # Panics
    /// If it is not running within 20 s.
    pub fn wait_running(&self) -> serde_json::Value {
        let pid = self.child.id();
        wait_for("the run to be running", Duration::from_secs(20), || {
            runs().into_iter().find(|s| s["pid"] == pid && s["state"] == "running")
        })
    }

    /// Process id of a node of this run.
    ///
    /// # Panics
    /// If the node does not exist.
    pub fn pid(&self, node: &str) -> i32 {
        let pid = self.child.id();
        wait_for(&format!("node {node} to have a process"), Duration::from_secs(20), || {
            let status = runs().into_iter().find(|s| s["pid"] == pid)?;
            let node = status["nodes"].as_array()?.iter().find(|n| n["name"] == node)?.clone();
            node["pid"].as_i64().filter(|p| *p > 0).map(|p| p as i32)
        })
    }

    /// Waits for its end.
    ///
    /// # Panics
    /// If the process cannot be waited for.
    pub fn output(self) -> Output {
        self.child.wait_with_output().expect("lacuna ends")
    }
}

/// `lacuna status --json`.
///
/// # Panics
/// If the status cannot be read.
pub fn runs() -> Vec<serde_json::Value> {
    let out = Command::new(bin("lacuna")).args(["status", "--json"]).output().expect("lacuna status");
    serde_json::from_slice(&out.stdout).expect("status is JSON")
}

/// Polls `check` until it gives a value.
///
/// # Panics
/// If it gives none within `limit`.
pub fn wait_for<T>(what: &str, limit: Duration, mut check: impl FnMut() -> Option<T>) -> T {
    let started = Instant::now();
    loop {
        if let Some(value) = check() {
            return value;
        }
        assert!(started.elapsed() < limit, "waited {} s for {what}", limit.as_secs());
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// Parses the JSON report of a finished run.
///
/// # Panics
/// If the run failed or printed no report.
pub fn report(output: &Output) -> serde_json::Value {
    let text = String::from_utf8_lossy(&output.stdout);
    serde_json::from_str(&text).unwrap_or_else(|e| {
        panic!("no report ({e}); stdout: {text}; stderr: {}", String::from_utf8_lossy(&output.stderr))
    })
}

/// The one line of standard error of a command that failed.
///
/// # Panics
/// If there is not exactly one line.
pub fn error_line(output: &Output) -> String {
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(text.trim_end().lines().count(), 1, "expected one line of error, found: {text}");
    text.trim_end().to_owned()
}

/// Asserts that nothing of the run is left in shared memory.
///
/// # Panics
/// If something is.
pub fn assert_shm_clean(run: &str) {
    let left: Vec<String> = std::fs::read_dir("/dev/shm")
        .into_iter()
        .flatten()
        .flatten()
        .filter_map(|e| e.file_name().into_string().ok())
        .filter(|n| n.starts_with(run))
        .collect();
    assert!(left.is_empty(), "left in /dev/shm: {left:?}");
}
