//! Robot, model and graph files from disk, with the file's name in every error.

use crate::ethercat;
use lacuna_interfaces::graph::GraphFile;
use lacuna_interfaces::{BadInput, ModelFile, RobotFile};
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Largest robot, model, graph or URDF file that is read [bytes].
pub const MAX_TEXT_BYTES: u64 = 16 << 20;

/// A robot file, its text and the URDF it names.
#[derive(Debug, Clone, PartialEq)]
pub struct LoadedRobot {
    /// The parsed and checked file.
    pub file: RobotFile,
    /// Text of the URDF, if the file names one.
    pub urdf: Option<String>,
    /// The file's own text, for attaching it to a recording.
    pub toml: String,
    /// Where it was read from.
    pub path: PathBuf,
    /// Where the URDF was read from, if there is one.
    pub urdf_path: Option<PathBuf>,
}

/// Reads a text file of at most [`MAX_TEXT_BYTES`].
///
/// # Errors
/// [`BadInput`] with the file's name: absent, unreadable, a folder, too large, or not UTF-8 (with the line).
pub fn read_text(path: &Path) -> Result<String, BadInput> {
    let fail = |what: String| BadInput::new(what).in_file(path);
    let file = File::open(path).map_err(|e| open_error(path, &e))?;
    let mut bytes = Vec::new();
    file.take(MAX_TEXT_BYTES + 1).read_to_end(&mut bytes).map_err(|e| fail(format!("cannot be read: {e}")))?;
    if bytes.len() as u64 > MAX_TEXT_BYTES {
        return Err(fail(format!("found more than {} MB; expected a text file below that", MAX_TEXT_BYTES >> 20)));
    }
    String::from_utf8(bytes).map_err(|e| {
        let good = e.utf8_error().valid_up_to();
        let line = e.as_bytes()[..good].iter().filter(|&&b| b == b'\n').count() as u64 + 1;
        fail("found bytes that are not UTF-8; expected text".to_owned()).at_line(line)
    })
}

/// The one wording for a file that cannot be opened.
pub(crate) fn open_error(path: &Path, error: &std::io::Error) -> BadInput {
    let what = match error.kind() {
        std::io::ErrorKind::NotFound => "found no such file; expected it to exist".to_owned(),
        _ => format!("cannot be opened: {error}"),
    };
    BadInput::new(what).in_file(path)
}

/// Reads a robot file and the URDF it names (a path relative to the robot file). Names in its `[ethercat]` table are
/// looked up in the ENI file beside it and become addresses.
///
/// # Errors
/// [`BadInput`] with file and line.
pub fn load_robot(path: impl AsRef<Path>) -> Result<LoadedRobot, BadInput> {
    let path = path.as_ref();
    let toml = read_text(path)?;
    let mut file = RobotFile::parse(&toml).map_err(|e| e.in_file(path))?;
    let folder = path.parent().unwrap_or(Path::new(""));
    if let Some(table) = &file.ethercat {
        file.ethercat = Some(ethercat::resolve(table, folder, file.joint_count())?);
    }
    let urdf_path = file.urdf.as_ref().map(|urdf| folder.join(urdf));
    let urdf = urdf_path.as_deref().map(read_text).transpose()?;
    Ok(LoadedRobot { file, urdf, toml, path: path.to_path_buf(), urdf_path })
}

/// Reads a model file and holds it against the robot. Also returns its text, for attaching it to a recording.
///
/// # Errors
/// [`BadInput`] with file and line, or with the key that does not fit the robot.
pub fn load_model(path: impl AsRef<Path>, robot: &RobotFile) -> Result<(ModelFile, String), BadInput> {
    let path = path.as_ref();
    let text = read_text(path)?;
    let model = ModelFile::parse(&text).map_err(|e| e.in_file(path))?;
    model.check(robot).map_err(|e| e.in_file(path))?;
    Ok((model, text))
}

/// Reads a graph file, `${…}` still unresolved, and its text.
///
/// # Errors
/// [`BadInput`] with file and line.
pub fn load_graph(path: impl AsRef<Path>) -> Result<(GraphFile, String), BadInput> {
    let path = path.as_ref();
    let text = read_text(path)?;
    let graph = GraphFile::parse(&text).map_err(|e| e.in_file(path))?;
    Ok((graph, text))
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROBOT: &str = "kind = \"serial\"\nname = \"arm\"\njoints = [\"a\"]\nurdf = \"sub/arm.urdf\"\n";

    #[test]
    fn urdf_is_found_beside_the_robot_file() {
        let dir = tempfile::tempdir().unwrap();
        let robot = dir.path().join("robot.toml");
        std::fs::write(&robot, ROBOT).unwrap();
        let e = load_robot(&robot).unwrap_err();
        assert!(e.to_string().contains("sub/arm.urdf: found no such file"), "{e}");
        std::fs::create_dir(dir.path().join("sub")).unwrap();
        std::fs::write(dir.path().join("sub/arm.urdf"), "<robot/>").unwrap();
        let loaded = load_robot(&robot).unwrap();
        assert_eq!(loaded.urdf.as_deref(), Some("<robot/>"));
        assert_eq!(loaded.toml, ROBOT);
    }

    #[test]
    fn errors_carry_file_and_line() {
        let dir = tempfile::tempdir().unwrap();
        let robot = dir.path().join("robot.toml");
        std::fs::write(&robot, format!("{ROBOT}colour = 1\n")).unwrap();
        let e = load_robot(&robot).unwrap_err().to_string();
        assert!(e.contains("robot.toml:5: ") && e.contains("colour"), "{e}");
        std::fs::write(&robot, b"kind\n\xff").unwrap();
        let e = load_robot(&robot).unwrap_err().to_string();
        assert!(e.contains("robot.toml:2: ") && e.contains("UTF-8"), "{e}");
        assert!(read_text(dir.path()).is_err(), "a folder is not a text file");
    }

    #[test]
    fn a_model_of_another_robot_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("model.toml");
        let robot = RobotFile::parse(&ROBOT.replace("urdf = \"sub/arm.urdf\"", "[[dh]]\na = 0.1")).unwrap();
        let mut model = ModelFile::nominal(&robot);
        std::fs::write(&path, model.to_toml().unwrap()).unwrap();
        assert_eq!(load_model(&path, &robot).unwrap().0, model);
        model.robot = "other".to_owned();
        std::fs::write(&path, model.to_toml().unwrap()).unwrap();
        let e = load_model(&path, &robot).unwrap_err().to_string();
        assert!(e.contains("model.toml: ") && e.contains("other"), "{e}");
    }
}
