//! A run's directory and its domain on the bus.
//!
//! Every run has a domain of its own: a root under `/dev/shm` and a file prefix, written to a TOML that
//! each process loads as its very first call to the bus (the bus would otherwise look for a configuration
//! in the working directory and the user's home). With root and prefix removed at the end nothing is left.

use crate::process::Failure;
use iceoryx2::prelude::*;
use lacuna_interfaces::graph::GraphFile;
use std::path::{Path as StdPath, PathBuf};
use std::time::Duration;

const GRAPH: &str = "graph.toml";
const DOMAIN: &str = "domain.toml";
const SHM: &str = "/dev/shm";

/// Directory of one run: resolved graph, domain, logs. Readable by its owner alone.
#[derive(Debug, Clone)]
pub struct RunDir {
    path: PathBuf,
}

impl RunDir {
    /// Writes the resolved graph and the domain of a new run into `path`, which must exist.
    ///
    /// # Errors
    /// [`Failure`] if a file cannot be written.
    pub fn create(path: &StdPath, graph: &GraphFile) -> Result<Self, Failure> {
        let run = Self { path: path.to_path_buf() };
        let io = |what: &str, e: &dyn std::fmt::Display| {
            Failure::run(format!("{}: cannot write {what}: {e}", path.display()))
        };
        let text = toml::to_string(graph).map_err(|e| io(GRAPH, &e))?;
        std::fs::write(run.path.join(GRAPH), text).map_err(|e| io(GRAPH, &e))?;
        let name = path.file_name().and_then(|n| n.to_str()).unwrap_or("run");
        let shm = run.shm_root();
        std::fs::create_dir(&shm).map_err(|e| Failure::run(format!("{}: cannot create: {e}", shm.display())))?;
        restrict(&shm)?;
        let mut config = Config::default();
        let bad = |e: SemanticStringError| Failure::run(format!("{name}: not usable as a domain name: {e:?}"));
        config.global.set_root_path(&Path::new(shm.display().to_string().as_bytes()).map_err(bad)?);
        config.global.prefix = FileName::new(format!("{name}_").as_bytes()).map_err(bad)?;
        let text = toml::to_string(&config).map_err(|e| io(DOMAIN, &e))?;
        std::fs::write(run.path.join(DOMAIN), text).map_err(|e| io(DOMAIN, &e))?;
        Ok(run)
    }

    /// An existing run.
    pub fn open(path: &StdPath) -> Self {
        Self { path: path.to_path_buf() }
    }

    /// The directory.
    pub fn path(&self) -> &StdPath {
        &self.path
    }

    /// Its name, unlike that of any other run.
    pub fn name(&self) -> &str {
        self.path.file_name().and_then(|n| n.to_str()).unwrap_or_default()
    }

    /// The resolved graph.
    ///
    /// # Errors
    /// [`Failure`] if there is none.
    pub fn graph(&self) -> Result<GraphFile, Failure> {
        let file = self.path.join(GRAPH);
        let text = std::fs::read_to_string(&file)
            .map_err(|e| Failure::usage(format!("{}: cannot read the run's graph: {e}", file.display())))?;
        GraphFile::parse(&text).map_err(|e| e.in_file(&file).into())
    }

    fn shm_root(&self) -> PathBuf {
        PathBuf::from(SHM).join(self.path.file_name().unwrap_or_default())
    }

    /// Removes everything the run's domain left in shared memory. Call it when no process of the run is left.
    pub fn remove_domain(&self) {
        // A path without a name would stand for all of shared memory.
        if self.name().is_empty() {
            return;
        }
        let _ = std::fs::remove_dir_all(self.shm_root());
        for path in self.shm_files() {
            let _ = std::fs::remove_file(path);
        }
    }

    /// The domain's segments in shared memory.
    pub(crate) fn shm_files(&self) -> Vec<PathBuf> {
        let Some(prefix) = self.path.file_name().and_then(|n| n.to_str()).map(|n| format!("{n}_")) else {
            return Vec::new();
        };
        let Ok(entries) = std::fs::read_dir(SHM) else { return Vec::new() };
        let own = entries.flatten().filter(|e| e.file_name().to_str().is_some_and(|n| n.starts_with(&prefix)));
        own.map(|e| e.path()).collect()
    }

    /// iceoryx2 0.10 makes one segment of a domain, the count of its nodes, for everybody to read and write: its
    /// owner's alone from here on.
    fn close_node_count(&self) -> Result<(), Failure> {
        use std::os::unix::fs::PermissionsExt;
        for path in self.shm_files().iter().filter(|p| p.extension().is_some_and(|e| e == "global_mgmt")) {
            match std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o600)) {
                Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
                    return Err(Failure::run(format!("{}: cannot restrict to its owner: {e}", path.display())));
                }
                _ => {}
            }
        }
        Ok(())
    }
}

fn restrict(dir: &StdPath) -> Result<(), Failure> {
    use std::os::unix::fs::PermissionsExt;
    std::fs::set_permissions(dir, std::fs::Permissions::from_mode(0o700))
        .map_err(|e| Failure::run(format!("{}: cannot restrict to its owner: {e}", dir.display())))
}

/// This process's place on the bus of a run.
#[derive(Debug)]
pub struct Domain {
    node: Node<ipc::Service>,
}

impl Domain {
    /// Joins the domain of `run` under `name`.
    ///
    /// # Errors
    /// [`Failure`] if the domain file is missing or unusable, or if this process already joined another one.
    pub fn join(run: &RunDir, name: &str) -> Result<Self, Failure> {
        set_log_level(LogLevel::Error);
        let file = run.path.join(DOMAIN);
        let fail =
            |e: &dyn std::fmt::Debug| Failure::run(format!("{}: cannot join the run's bus: {e:?}", file.display()));
        let path = FilePath::new(file.display().to_string().as_bytes()).map_err(|e| fail(&e))?;
        let config = Config::setup_global_config_from_file(&path).map_err(|e| fail(&e))?;
        if config.global.root_path().to_string() != run.shm_root().display().to_string() {
            return Err(Failure::run(format!("{}: this process already joined another bus", file.display())));
        }
        let node = NodeBuilder::new()
            .name(&NodeName::new(name).map_err(|e| fail(&e))?)
            // Signals are the harness's: the bus's own handler turns a SIGTERM in a blocked send into an error.
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<ipc::Service>()
            .map_err(|e| fail(&e))?;
        run.close_node_count()?;
        Ok(Self { node })
    }

    pub(crate) fn node(&self) -> &Node<ipc::Service> {
        &self.node
    }

    /// Frees what killed processes of this run left on the bus; their readers and writers disappear from it.
    pub fn clean_dead_nodes(&self) {
        let _ = self.node.blocking_cleanup_dead_nodes(Duration::from_millis(200));
    }
}
