//! Inertials into a URDF: what our own reader, and Pinocchio, then calculate.

use lacuna_interfaces::{BadInput, RobotFile};
use lacuna_physics::serial::urdf::write::{LinkValues, with_inertials};
use lacuna_physics::{Motion, RigidBody, SerialChain};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::path::Path;
use std::process::{Command, Stdio};

/// Skew axes, a slide, fixed links between and behind, one of them without contents and one in short form.
const URDF: &str = include_str!("../../simulate/tests/goldens/arm.urdf");
const JOINTS: [&str; 4] = ["j1", "j2", "slide", "j4"];

fn names() -> Vec<String> {
    JOINTS.map(str::to_owned).to_vec()
}

fn chain(urdf: &str) -> SerialChain {
    let text = "kind = \"serial\"\nname = \"arm\"\nurdf = \"arm.urdf\"\njoints = [\"j1\", \"j2\", \"slide\", \"j4\"]\n";
    SerialChain::new(&RobotFile::parse(text).unwrap(), Some(urdf)).unwrap()
}

/// Other links, each possible: heavier, off-centre, turned, with rotors.
fn other(pi: &[f64]) -> Vec<f64> {
    let mut pi = pi.to_vec();
    for (i, link) in pi.chunks_exact_mut(11).enumerate() {
        let scale = 1.0 + 0.2 * (i as f64 + 1.0);
        link[..10].iter_mut().for_each(|v| *v *= scale);
        // A ball of 1 kg and radius 0.1 m at (0.05, −0.02, 0.1) welded on.
        let (c, own) = ([0.05, -0.02, 0.1], 0.4 * 0.01);
        link[0] += 1.0;
        (0..3).for_each(|k| link[1 + k] += c[k]);
        let square: f64 = c.iter().map(|v| v * v).sum();
        for (slot, (a, b)) in [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)].into_iter().enumerate() {
            let on = if a == b { own + square } else { 0.0 };
            link[4 + slot] += on - c[a] * c[b];
        }
        link[10] = 0.01 * (i as f64 + 1.0);
    }
    pi
}

fn write(pi: &[f64]) -> Result<String, BadInput> {
    let mut links = LinkValues::of_parameters(pi);
    for (i, link) in links.iter_mut().enumerate() {
        link.friction = Some((0.5 + i as f64, 2.0));
    }
    with_inertials(URDF, &names(), &links, &["by hand -- with hyphens ---".to_owned()])
}

#[test]
fn what_is_written_is_what_is_read() {
    let input = chain(URDF).nominal();
    for pi in [input.clone(), other(&input)] {
        let text = write(&pi).unwrap();
        let read = chain(&text).nominal();
        for (k, (a, b)) in read.iter().zip(&pi).enumerate() {
            // Rotors have no place in a URDF.
            let expected = if k % 11 == 10 { 0.0 } else { *b };
            assert!((a - expected).abs() < 1e-13 * (1.0 + b.abs()), "parameter {k}: {a}, {expected}");
        }
        let document = roxmltree::Document::parse(&text).unwrap();
        let count = |tag: &str| document.descendants().filter(|n| n.has_tag_name(tag)).count();
        // The base keeps its own; bracket and tool are part of what they are fixed to.
        assert_eq!((count("inertial"), count("dynamics"), count("link")), (5, 4, 8));
        let friction = document.descendants().find(|n| n.attribute("name") == Some("slide")).unwrap();
        let friction = friction.children().find(|n| n.has_tag_name("dynamics")).unwrap();
        assert_eq!((friction.attribute("damping"), friction.attribute("friction")), (Some("2.5"), Some("2")));
        // Written again with the same values, nothing but the comments grows.
        let again = with_inertials(&text, &names(), &LinkValues::of_parameters(&pi), &[]).unwrap();
        assert_eq!(chain(&again).nominal(), read);
    }
}

#[test]
fn links_without_contents_get_some() {
    let short = "<robot name=\"r\"><link name=\"base\"/><joint name=\"a\" type=\"revolute\"><parent link=\"base\"/>\
        <child link=\"arm\"/><axis xyz=\"0 0 1\"/></joint><link name=\"arm\"/></robot>";
    let empty = short.replace("<link name=\"arm\"/>", "<link name=\"arm\"></link>");
    for text in [short, empty.as_str()] {
        let mut pi = [0.0; 11];
        (pi[0], pi[1], pi[4], pi[7], pi[9]) = (2.0, 0.2, 0.1, 0.12, 0.12);
        let robot = "kind = \"serial\"\nname = \"r\"\nurdf = \"r.urdf\"\njoints = [\"a\"]\n";
        let links = LinkValues::of_parameters(&pi);
        let out = with_inertials(text, &["a".to_owned()], &links, &[]).unwrap();
        let chain = SerialChain::new(&RobotFile::parse(robot).unwrap(), Some(&out)).unwrap();
        for (a, b) in chain.nominal().iter().zip(pi) {
            assert!((a - b).abs() < 1e-14, "{out}");
        }
    }
}

#[test]
fn what_could_not_exist_is_refused() {
    let good = chain(URDF).nominal();
    let with = |at: usize, value: f64| {
        let mut pi = good.clone();
        pi[at] = value;
        write(&pi).unwrap_err().to_string()
    };
    assert!(with(11, 0.0).contains("link 'l2'") && with(11, -1.0).contains("above zero"));
    assert!(with(0, f64::NAN).contains("mass"));
    // A moment of inertia below what its first moments alone need, and one beyond the triangle inequality.
    assert!(with(11 + 9, 1e-3).contains("second moment") && with(4, 50.0).contains("second moment"));
    let error = with_inertials(URDF, &names(), &[], &[]).unwrap_err().to_string();
    assert!(error.contains("0 links for 4 joints"));
    let links = LinkValues::of_parameters(&good);
    assert!(with_inertials("<robot", &names(), &links, &[]).unwrap_err().to_string().contains("XML"));
    let unknown = ["j1", "j2", "slide", "wrist"].map(str::to_owned);
    assert!(with_inertials(URDF, &unknown, &links, &[]).unwrap_err().to_string().contains("wrist"));
}

/// Pinocchio, an independent reader and an independent dynamics, asks the same torque of the file as our model does.
#[test]
fn pinocchio_calculates_the_same_torque() {
    let Some(python) = std::env::var_os("LACUNA_TEST_PYTHON") else {
        eprintln!("SKIPPED: LACUNA_TEST_PYTHON names no Python with Pinocchio");
        return;
    };
    let body = chain(URDF);
    let pi = other(&body.nominal());
    let mut random = Pcg64Mcg::seed_from_u64(7);
    let mut numbers = |scale: f64| -> Vec<f64> { (0..4).map(|_| random.random_range(-scale..scale)).collect() };
    let motions: Vec<[Vec<f64>; 3]> = (0..50).map(|_| [numbers(2.0), numbers(3.0), numbers(20.0)]).collect();
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("model.urdf"), write(&pi).unwrap()).unwrap();
    std::fs::write(dir.path().join("motions.json"), serde_json::to_string(&motions).unwrap()).unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/oracles/urdf_torque.py");
    let rotors: Vec<String> = pi.chunks_exact(11).map(|l| l[10].to_string()).collect();
    let out = Command::new(python)
        .arg(script)
        .args(["model.urdf", "motions.json", &JOINTS.join(","), &rotors.join(",")])
        .current_dir(dir.path())
        .stderr(Stdio::piped())
        .output()
        .unwrap();
    if out.status.code() == Some(77) {
        eprintln!("SKIPPED: this Python has no Pinocchio");
        return;
    }
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let theirs: Vec<Vec<f64>> = serde_json::from_slice(&out.stdout).unwrap();
    assert_eq!(theirs.len(), motions.len());
    let mut worst = 0.0f64;
    for ([q, qd, qdd], theirs) in motions.iter().zip(&theirs) {
        let mut tau = [0.0; 4];
        body.torque(&Motion { q_rad: q, qd_rad_s: qd, qdd_rad_s2: qdd }, &pi, &mut tau).unwrap();
        for (a, b) in tau.iter().zip(theirs) {
            worst = worst.max((a - b).abs() / (1.0 + a.abs()));
        }
    }
    eprintln!("largest relative difference to Pinocchio {worst:.1e}");
    assert!(worst < 1e-10, "{worst}");
}
