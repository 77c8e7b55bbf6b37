//! The URDF reader: what it merges, and what it refuses in words with a line.

use lacuna_interfaces::RobotFile;
use lacuna_physics::serial::Target;
use lacuna_physics::{RigidBody, SerialChain, Unreachable};
use proptest::prelude::*;

mod common;

/// Two joints, a fixed sensor between and a fixed flange behind.
const URDF: &str = r#"<robot name="two">
<link name="world"/>
<joint name="foot" type="fixed"><parent link="world"/><child link="base"/><origin xyz="0 0 0.5"/></joint>
<link name="base"><inertial><mass value="9"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
<joint name="lift" type="prismatic"><parent link="base"/><child link="cart"/><axis xyz="0 0 2"/></joint>
<link name="cart"><inertial><origin xyz="0.1 0 0"/><mass value="2"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
<joint name="glue" type="fixed"><parent link="cart"/><child link="sensor"/><origin xyz="0 0.2 0"/></joint>
<link name="sensor"><inertial><mass value="0.5"/><inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial></link>
<joint name="turn" type="continuous"><parent link="sensor"/><child link="arm"/><origin xyz="0.3 0 0"/><axis xyz="0 1 0"/></joint>
<link name="arm"><inertial><mass value="1"/><inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial></link>
<joint name="bolt" type="fixed"><parent link="arm"/><child link="flange"/><origin xyz="0 0 0.4"/></joint>
<link name="flange"/>
</robot>
"#;

fn robot(joints: &str) -> RobotFile {
    RobotFile::parse(&format!("kind = \"serial\"\nname = \"two\"\nurdf = \"two.urdf\"\njoints = [{joints}]\n")).unwrap()
}

fn read(text: &str, joints: &str) -> Result<SerialChain, lacuna_interfaces::BadInput> {
    SerialChain::new(&robot(joints), Some(text))
}

#[test]
fn fixed_joints_are_merged() {
    let chain = read(URDF, "\"lift\", \"turn\"").unwrap();
    let value = |symbol: &str| chain.parameters().iter().find(|p| p.symbol == symbol).unwrap().nominal;
    assert_eq!(value("m1"), 2.5);
    assert!((value("mx1") - 0.2).abs() < 1e-15 && (value("my1") - 0.1).abs() < 1e-15);
    // Izz about the cart's origin: 1 + 2·0.1² + 0.5·0.2².
    assert!((value("Izz1") - 1.04).abs() < 1e-15);
    assert_eq!(chain.parameters()[10].unit, "kg");
    assert_eq!(chain.parameters()[21].unit, "kg m^2");
    // Foot, lift along the normalised axis, sensor, joint origin, flange turned about y by 90°.
    let tip = chain.tip(&[0.2, std::f64::consts::FRAC_PI_2]).unwrap().position_m;
    for (found, expected) in tip.iter().zip([0.3 + 0.4, 0.2, 0.5 + 0.2]) {
        assert!((found - expected).abs() < 1e-15, "{tip:?}");
    }
}

#[test]
fn urdf_errors_name_line_and_expectation() {
    let both = "\"lift\", \"turn\"";
    for (from, to, joints, line, words) in [
        ("", "", "\"lift\", \"spin\"", None, &["spin", "lift, turn"][..]),
        ("", "", "\"lift\", \"glue\"", Some(7), &["fixed", "prismatic"]),
        ("", "", "\"turn\", \"lift\"", Some(9), &["lift", "turn", "first"]),
        (
            "parent link=\"sensor\"",
            "parent link=\"base\"",
            both,
            Some(9),
            &["'turn' does not follow 'lift'", "chain order"],
        ),
        ("", "", "\"turn\"", Some(9), &["turn", "lift", "name"]),
        ("", "", "\"lift\"", Some(9), &["turn", "does not name"]),
        ("continuous", "floating", both, Some(9), &["floating", "revolute"]),
        ("continuous", "planar", both, Some(9), &["planar"]),
        ("mass value=\"2\"", "mass value=\"two\"", both, Some(6), &["two", "finite"]),
        ("mass value=\"2\"", "mass value=\"1e999\"", both, Some(6), &["1e999"]),
        ("mass value=\"2\"", "mass value=\"-2\"", both, Some(6), &["-2", "zero or more"]),
        ("mass value=\"2\"", "mass", both, Some(6), &["no value"]),
        ("xyz=\"0.1 0 0\"", "xyz=\"0.1 0\"", both, Some(6), &["2 numbers", "expected 3"]),
        ("xyz=\"0 1 0\"", "xyz=\"0 0 0\"", both, Some(9), &["zero vector"]),
        ("ixy=\"0\"", "", both, Some(4), &["ixy"]),
        ("child link=\"arm\"", "child link=\"leg\"", both, Some(9), &["leg", "does not exist"]),
        ("child link=\"arm\"", "child link=\"cart\"", both, Some(9), &["cart", "tree"]),
        ("<parent link=\"sensor\"/>", "", both, Some(9), &["turn", "<parent>"]),
        ("link name=\"flange\"", "link name=\"arm\"", both, Some(12), &["arm", "twice"]),
        ("joint name=\"bolt\"", "joint name=\"glue\"", both, Some(11), &["glue", "twice"]),
        ("parent link=\"world\"", "parent link=\"base\"", both, None, &["loop"]),
        ("</robot>", "", both, None, &["XML"]),
        ("<robot name=\"two\">", "<mujoco>", both, None, &["XML"]),
    ] {
        assert!(from.is_empty() || URDF.contains(from), "{from}");
        let error = read(&URDF.replacen(from, to, 1), joints).unwrap_err();
        if line.is_some() {
            assert_eq!(error.line, line, "{from} -> {to}: {error}");
        }
        for word in words {
            assert!(error.to_string().contains(word), "{from} -> {to}: '{word}' not in: {error}");
        }
        assert!(!error.to_string().contains('\n'), "{error}");
    }
}

#[test]
fn other_formats_are_named() {
    let error = read("<mujoco/>", "\"a\"").unwrap_err();
    assert!(error.what.contains("<mujoco>") && error.what.contains("<robot>"), "{error}");
    let macros = "<robot xmlns:xacro=\"http://www.ros.org/wiki/xacro\">\n<xacro:include filename=\"a\"/></robot>";
    let error = read(macros, "\"a\"").unwrap_err();
    assert!(error.what.contains("xacro") && error.line == Some(2), "{error}");
    assert!(SerialChain::new(&robot("\"a\""), None).unwrap_err().what.contains("two.urdf"));
    let delta = RobotFile::parse(common::DELTA).unwrap();
    assert!(SerialChain::new(&delta, None).is_err());
    assert!(lacuna_physics::Delta::new(&robot("\"a\"")).is_err());
}

#[test]
fn a_second_arm_of_the_base_does_not_matter() {
    let other = "<joint name=\"left\" type=\"revolute\"><parent link=\"base\"/><child link=\"claw\"/></joint><link name=\"claw\"/></robot>";
    let with = read(&URDF.replace("</robot>", other), "\"lift\", \"turn\"").unwrap();
    let without = read(URDF, "\"lift\", \"turn\"").unwrap();
    assert_eq!(with.parameters(), without.parameters());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Inverse kinematics of a six-joint arm comes back to the pose it started from.
    #[test]
    fn inverse_kinematics_reaches_what_forward_gave(
        q in prop::array::uniform6(-1.2..1.2_f64), off in prop::array::uniform6(-0.25..0.25_f64)
    ) {
        let chain = SerialChain::new(&RobotFile::parse(common::ARM).unwrap(), None).unwrap();
        let goal = chain.tip(&q).unwrap();
        let start: Vec<f64> = q.iter().zip(&off).map(|(a, b)| a + b).collect();
        for target in [Target::Pose(goal), Target::Position(goal.position_m)] {
            let found = chain.inverse(&target, &start).unwrap();
            let tip = chain.tip(&found[..6]).unwrap();
            prop_assert!(common::relative(&tip.position_m, &goal.position_m, 1.0) < 1e-9);
            if let Target::Pose(_) = target {
                prop_assert!(common::relative(tip.rotation.as_flattened(), goal.rotation.as_flattened(), 1.0) < 1e-9);
            }
        }
    }

    /// Broken text never panics.
    #[test]
    fn cut_and_garbled_text(at in 0..URDF.len(), length in 0..40_usize, junk in "[ -~]{0,8}") {
        let mut text = URDF.as_bytes().to_vec();
        text.splice(at..(at + length).min(URDF.len()), junk.bytes());
        let _ = read(&String::from_utf8_lossy(&text), "\"lift\", \"turn\"");
    }
}

#[test]
fn inverse_kinematics_out_of_reach() {
    let chain = SerialChain::new(&RobotFile::parse(common::ARM).unwrap(), None).unwrap();
    let error = chain.inverse(&Target::Position([5.0, 0.0, 0.0]), &[0.1; 6]).unwrap_err();
    let Unreachable::NoConvergence { error_m, .. } = error else { panic!("{error:?}") };
    assert!(error_m > 3.0, "{error}");
    assert!(chain.inverse(&Target::Position([f64::NAN; 3]), &[0.1; 6]).is_err());
    assert!(chain.inverse(&Target::Position([0.0; 3]), &[0.1; 5]).is_err());
}
