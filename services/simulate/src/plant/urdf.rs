//! The chain of a URDF: joints by name in the robot file's order, everything fixed in between merged.

use super::serial::{Body, Link, Serial, placement};
use lacuna_interfaces::BadInput;
use nalgebra::{Isometry3, Matrix3, Vector3};
use roxmltree::{Document, Node};

/// Links that may hang on each other one behind the other.
const MAX_DEPTH: usize = 64;

type Found<'a, 'd> = Option<Node<'a, 'd>>;

/// Builds the chain through the joints named `names`; also the rotor inertias (zero: URDF has none).
///
/// # Errors
/// [`BadInput`] if the text is not a URDF, a joint is missing, or the joints are not one behind the other.
pub fn chain(text: &str, names: &[String]) -> Result<(Serial, Vec<f64>), BadInput> {
    let document =
        Document::parse(text).map_err(|e| BadInput::new(format!("URDF: {e}")).at_line(u64::from(e.pos().row)))?;
    let robot = document.root_element();
    let joints: Vec<Node> = robot.children().filter(|n| n.has_tag_name("joint")).collect();
    let by_name = |name: &str| -> Result<Node, BadInput> {
        joints
            .iter()
            .find(|j| j.attribute("name") == Some(name))
            .copied()
            .ok_or_else(|| BadInput::new(format!("URDF: found no joint \"{name}\"; the robot file names it")))
    };
    let mut links = Vec::new();
    for (i, name) in names.iter().enumerate() {
        let joint = by_name(name)?;
        let prismatic = match joint.attribute("type") {
            Some("revolute" | "continuous") => false,
            Some("prismatic") => true,
            other => {
                return Err(BadInput::new(format!(
                    "URDF: joint \"{name}\" is of type {other:?}; expected revolute, continuous or prismatic"
                )));
            }
        };
        // Down from this joint to the joint before it (or to the root), through fixed joints only.
        let parent_joint = if i == 0 { None } else { Some(by_name(&names[i - 1])?) };
        let stop = parent_joint.map(|j| link_name(j, "child")).transpose()?;
        let mut place = origin(joint)?;
        let mut at = link_name(joint, "parent")?;
        let mut hops = 0;
        while stop != Some(at) {
            hops += 1;
            if hops > MAX_DEPTH {
                return Err(circle(at));
            }
            let Some(above) = parent_of(&joints, at) else {
                if stop.is_none() {
                    break;
                }
                return Err(BadInput::new(format!(
                    "URDF: joint \"{name}\" does not hang on joint \"{}\"; expected the robot file's joints one behind the other",
                    names[i - 1]
                )));
            };
            place = origin(above)? * place;
            at = link_name(above, "parent")?;
        }
        let body = merged_body(robot, &joints, link_name(joint, "child")?, names, 0)?;
        links.push(Link { place, axis: axis(joint)?, prismatic, body });
    }
    let rotors = vec![0.0; links.len()];
    let tip = match names.last() {
        Some(last) => flange(&joints, link_name(by_name(last)?, "child")?)?,
        None => Isometry3::identity(),
    };
    let described_in = vec![Isometry3::identity(); links.len()];
    Ok((Serial { links, tip, described_in }, rotors))
}

/// The frame behind a link as long as exactly one fixed joint leads on.
fn flange(joints: &[Node], link: &str) -> Result<Isometry3<f64>, BadInput> {
    let mut at = link;
    let mut frame = Isometry3::identity();
    for _ in 0..MAX_DEPTH {
        let mut next = joints.iter().filter(|j| link_name(**j, "parent").ok() == Some(at));
        match (next.next(), next.next()) {
            (Some(joint), None) if joint.attribute("type") == Some("fixed") => {
                frame *= origin(*joint)?;
                at = link_name(*joint, "child")?;
            }
            _ => return Ok(frame),
        }
    }
    Err(circle(link))
}

fn parent_of<'a, 'd>(joints: &[Node<'a, 'd>], link: &str) -> Found<'a, 'd> {
    joints.iter().find(|j| link_name(**j, "child").ok() == Some(link)).copied()
}

fn circle(link: &str) -> BadInput {
    BadInput::new(format!("URDF: links hang on each other in a circle at \"{link}\"; expected a tree"))
}

fn child<'a, 'd>(node: Node<'a, 'd>, tag: &str) -> Found<'a, 'd> {
    node.children().find(|n| n.has_tag_name(tag))
}

fn link_name<'a>(joint: Node<'a, '_>, tag: &str) -> Result<&'a str, BadInput> {
    child(joint, tag).and_then(|n| n.attribute("link")).ok_or_else(|| {
        BadInput::new(format!("URDF: joint {:?} has no <{tag} link=…>", joint.attribute("name").unwrap_or("")))
    })
}

fn numbers<const N: usize>(text: &str) -> Result<[f64; N], BadInput> {
    let bad = || BadInput::new(format!("URDF: found \"{text}\"; expected {N} finite numbers"));
    let values: Vec<f64> = text.split_whitespace().map(|w| w.parse().map_err(|_| bad())).collect::<Result<_, _>>()?;
    let array: [f64; N] = values.try_into().map_err(|_| bad())?;
    if array.iter().all(|v| v.is_finite()) { Ok(array) } else { Err(bad()) }
}

fn attribute<const N: usize>(node: Found, name: &str, default: [f64; N]) -> Result<[f64; N], BadInput> {
    node.and_then(|n| n.attribute(name)).map_or(Ok(default), numbers)
}

fn origin(node: Node) -> Result<Isometry3<f64>, BadInput> {
    let o = child(node, "origin");
    Ok(placement(attribute(o, "xyz", [0.0; 3])?, attribute(o, "rpy", [0.0; 3])?))
}

fn axis(joint: Node) -> Result<Vector3<f64>, BadInput> {
    let a = Vector3::from(attribute(child(joint, "axis"), "xyz", [1.0, 0.0, 0.0])?);
    let norm = a.norm();
    if norm > 1e-9 {
        Ok(a / norm)
    } else {
        Err(BadInput::new("URDF: found a joint axis of length 0; expected a direction"))
    }
}

/// The link's body with every body that hangs on it by joints the robot file does not move.
fn merged_body(robot: Node, joints: &[Node], name: &str, moved: &[String], depth: usize) -> Result<Body, BadInput> {
    if depth > MAX_DEPTH {
        return Err(circle(name));
    }
    let link = robot
        .children()
        .find(|n| n.has_tag_name("link") && n.attribute("name") == Some(name))
        .ok_or_else(|| BadInput::new(format!("URDF: found no link \"{name}\"; a joint names it")))?;
    let mut body = inertial(link)?;
    for joint in joints {
        let is_moved = joint.attribute("name").is_some_and(|n| moved.iter().any(|m| m == n));
        if !is_moved && link_name(*joint, "parent")? == name {
            let hung = merged_body(robot, joints, link_name(*joint, "child")?, moved, depth + 1)?;
            body = body.merged(&hung.placed(&origin(*joint)?));
        }
    }
    Ok(body)
}

fn inertial(link: Node) -> Result<Body, BadInput> {
    let Some(node) = child(link, "inertial") else { return Ok(Body::default()) };
    let [mass] = attribute(child(node, "mass"), "value", [0.0])?;
    let i = child(node, "inertia");
    let get = |name| attribute(i, name, [0.0]).map(|[v]| v);
    let (xx, xy, xz) = (get("ixx")?, get("ixy")?, get("ixz")?);
    let (yy, yz, zz) = (get("iyy")?, get("iyz")?, get("izz")?);
    let body = Body::new(mass, Vector3::zeros(), Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz));
    Ok(body.placed(&origin(node)?))
}
