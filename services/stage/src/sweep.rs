//! Takes segments off the bus that nobody will finish.
//!
//! A process that is killed between making a segment of shared memory and giving it a size leaves it empty. Whoever
//! opens an empty segment waits for its size, and iceoryx2 0.10 does so without an end
//! (`dynamic_storage/posix_shared_memory.rs`, `open_impl`): the supervisor that cleans up after the dead process, and
//! every reader or writer that would connect to it, stand still. Once the segment is gone they find that there is none.

use crate::domain::RunDir;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

/// How often the run's segments are looked at: what has none unfinished costs a listing of the folder.
const PERIOD: Duration = Duration::from_millis(50);
/// Younger ones may have a maker where this process cannot see it, in a container of its own.
const LEAST_AGE: Duration = Duration::from_millis(100);

/// Looks after a run's segments until it is dropped.
#[derive(Debug)]
pub struct Sweeper {
    stop: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Sweeper {
    /// Begins to look after the segments of `run`.
    pub fn start(run: &RunDir) -> Self {
        let run = run.clone();
        let (stop, stopped) = channel();
        let thread = std::thread::spawn(move || {
            while stopped.recv_timeout(PERIOD) == Err(RecvTimeoutError::Timeout) {
                remove_unfinished(&run);
            }
        });
        Self { stop: Some(stop), thread: Some(thread) }
    }
}

impl Drop for Sweeper {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Removes the segments of `run` that are not finished and whose makers are gone; which they were.
///
/// A maker has its segment open until it is finished. One that is unfinished, is then open nowhere, and is the same and
/// unfinished still, has no maker any more. Who waits for it opens it for moments only: another look finds it closed.
fn remove_unfinished(run: &RunDir) -> Vec<PathBuf> {
    let mut removed = Vec::new();
    for path in run.shm_files() {
        let Some(before) = unfinished(&path) else { continue };
        if is_open(&path) || unfinished(&path) != Some(before) {
            continue;
        }
        if std::fs::remove_file(&path).is_ok() {
            removed.push(path);
        }
    }
    removed
}

/// The inode of a segment that has no size, or that its maker has not made readable yet, after [`LEAST_AGE`].
fn unfinished(path: &Path) -> Option<u64> {
    let data = std::fs::metadata(path).ok().filter(std::fs::Metadata::is_file)?;
    let old = data.modified().ok()?.elapsed().is_ok_and(|age| age >= LEAST_AGE);
    (old && (data.len() == 0 || data.permissions().mode() & 0o400 == 0)).then(|| data.ino())
}

/// Whether any process that this one may ask has the file open.
fn is_open(path: &Path) -> bool {
    let list = |folder: &Path| std::fs::read_dir(folder).into_iter().flatten().flatten();
    let is_process = |name: &std::ffi::OsStr| name.to_str().is_some_and(|n| n.bytes().all(|b| b.is_ascii_digit()));
    list(Path::new("/proc"))
        .filter(|process| is_process(&process.file_name()))
        .flat_map(|process| list(&process.path().join("fd")))
        .any(|open| std::fs::read_link(open.path()).is_ok_and(|to| to == path))
}

#[cfg(test)]
mod tests {
    use super::*;
    use lacuna_interfaces::graph::GraphFile;
    use std::io::Write;

    const GRAPH: &str = "name = \"g\"\nmode = \"live\"\n[[node]]\nname = \"n\"\nexec = \"x\"\noutput = \"t\"\n";

    #[test]
    fn what_nobody_will_finish_is_removed_and_nothing_else() {
        let dir = std::env::temp_dir().join(format!("lacuna-sweep-{}", std::process::id()));
        std::fs::create_dir(&dir).unwrap();
        let run = RunDir::create(&dir, &GraphFile::parse(GRAPH).unwrap()).unwrap();
        let segment = |name: &str, text: &[u8]| {
            let path = PathBuf::from(format!("/dev/shm/{}_{name}", run.name()));
            let mut file = std::fs::File::create(&path).unwrap();
            file.write_all(text).unwrap();
            (path, file)
        };
        let (empty, _) = segment("a.connection", b"");
        let (whole, _) = segment("b.data", b"data");
        let (locked, _) = segment("c.data", b"data");
        std::fs::set_permissions(&locked, std::fs::Permissions::from_mode(0o200)).unwrap();
        let (in_the_making, maker) = segment("d.data", b"");
        assert_eq!(remove_unfinished(&run), [] as [PathBuf; 0], "they may be in the making where nobody sees it");
        std::thread::sleep(2 * LEAST_AGE);
        let mut removed = remove_unfinished(&run);
        removed.sort();
        assert_eq!(removed, [empty, locked]);
        assert!(whole.exists() && in_the_making.exists());
        drop(maker);
        let sweeper = Sweeper::start(&run);
        let begun = std::time::Instant::now();
        while in_the_making.exists() && begun.elapsed() < Duration::from_secs(20) {
            std::thread::sleep(Duration::from_millis(5));
        }
        drop(sweeper);
        assert!(whole.exists() && !in_the_making.exists());
        run.remove_domain();
        assert!(!whole.exists());
        std::fs::remove_dir_all(&dir).unwrap();
    }
}
