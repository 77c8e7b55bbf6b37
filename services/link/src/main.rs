//! A live stream from one machine to another, over iceoryx2's own zenoh tunnel (`iox2-link-tunnel-zenoh`).
//!
//! On the robot's machine the link is a reader of the topic, on the other it is the source of the graph there. Each end
//! starts a tunnel beside itself, which joins the run's domain on the bus, sees the one topic `link/NAME` and nothing
//! else, and meets the other machine's tunnel at the address that the graph file gives. docs/TWO_MACHINES.md says what
//! is promised and what is not.

mod config;

use config::{Config, tunnel_domain};
use lacuna_interfaces::BadInput;
use lacuna_stage::bus::link_topic;
use lacuna_stage::{Carrier, Clocks, LinkContext, run_link};
use std::fs::{DirBuilder, OpenOptions};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::PathBuf;
use std::process::{Child, Command, ExitCode, Stdio};
use std::time::{Duration, Instant};

/// Runs the tunnel and ends it when this process is gone, however that came: then the pipe on standard input closes.
const KEEPER: &str = "exec 3<&0\n\"$@\" </dev/null 3<&- &\npid=$!\n{ cat <&3 >/dev/null; kill \"$pid\" 2>/dev/null; } &\nwait \"$pid\"\n";
/// How long a tunnel may take to end.
const GRACE: Duration = Duration::from_secs(2);

struct Tunnel {
    config: Config,
    topic: String,
    folder: PathBuf,
    domain: PathBuf,
    child: Option<Child>,
}

impl Carrier for Tunnel {
    type Config = Config;

    fn new(config: Config, context: &LinkContext<'_>) -> Result<Self, BadInput> {
        config.check()?;
        if !context.sends && config.message.is_none() {
            return Err(BadInput::new(
                "message: found none; expected the message that comes over the link, as in message = \"JointMeasured\"",
            ));
        }
        Ok(Self {
            config,
            topic: link_topic(context.topic),
            folder: context.run.path().join(format!("{}.tunnel", context.node)),
            domain: context.run.path().join("domain.toml"),
            child: None,
        })
    }

    fn message(&self) -> Option<&str> {
        self.config.message.as_deref()
    }

    fn settle(&self) -> Duration {
        Duration::from_secs_f64(self.config.settle_s)
    }

    fn clocks(&self) -> Clocks {
        self.config.clocks
    }

    fn start(&mut self) -> Result<(), String> {
        let fail = |what: &dyn std::fmt::Display| format!("{}: {what}", self.folder.display());
        // The tunnel looks for the bus's configuration in config/ of its working directory.
        let config = self.folder.join("config");
        DirBuilder::new().recursive(true).mode(0o700).create(&config).map_err(|e| fail(&e))?;
        let domain = std::fs::read_to_string(&self.domain).map_err(|e| fail(&e))?;
        std::fs::write(config.join("iceoryx2.toml"), tunnel_domain(&domain)).map_err(|e| fail(&e))?;
        std::fs::write(self.folder.join("zenoh.json5"), self.config.zenoh()).map_err(|e| fail(&e))?;
        // Its log is its own: standard error of this process is for what the link has to say.
        let log = OpenOptions::new().create(true).append(true).mode(0o600).open(self.folder.join("log"));
        let log = log.map_err(|e| fail(&e))?;
        let other = log.try_clone().map_err(|e| fail(&e))?;
        let child = Command::new("/bin/sh")
            .args(["-c", KEEPER, "lacuna-link"])
            .arg(&self.config.tunnel)
            .args(["--zenoh-config", "zenoh.json5", "--allow", &self.topic, "--poll", &self.config.poll_ms.to_string()])
            .current_dir(&self.folder)
            .stdin(Stdio::piped())
            .stdout(log)
            .stderr(other)
            .spawn()
            .map_err(|e| format!("{}: cannot be started: {e}", self.config.tunnel.display()))?;
        self.child = Some(child);
        Ok(())
    }

    fn check(&mut self) -> Result<(), String> {
        let Some(status) = self.child.as_mut().and_then(|c| c.try_wait().ok().flatten()) else { return Ok(()) };
        let log = std::fs::read_to_string(self.folder.join("log")).unwrap_or_default();
        let last = log.lines().rev().find(|l| !l.trim().is_empty()).unwrap_or("its log is empty").trim().to_owned();
        Err(format!(
            "the tunnel {} ended ({status}): {last}; expected it to run (docs/TWO_MACHINES.md says how it is installed)",
            self.config.tunnel.display()
        ))
    }
}

impl Drop for Tunnel {
    fn drop(&mut self) {
        let Some(mut child) = self.child.take() else { return };
        // The keeper sees its input close and ends the tunnel.
        drop(child.stdin.take());
        let until = Instant::now() + GRACE;
        while Instant::now() < until && matches!(child.try_wait(), Ok(None)) {
            std::thread::sleep(Duration::from_millis(5));
        }
        let _ = child.kill();
        let _ = child.wait();
    }
}

fn main() -> ExitCode {
    run_link::<Tunnel>()
}
