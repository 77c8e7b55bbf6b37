//! Reads a chain of named joints out of a URDF.
//!
//! The root link is the base frame. Fixed joints are merged, also those before the first and behind the last
//! named joint. Whatever moves with the chain must be part of it: an unnamed movable joint on the way or on a
//! branch is refused, because its position is not in the recording. Visuals, collisions, limits, dynamics and
//! transmissions are not read.

pub mod write;

use super::chain::{Body, Placement, Segment, about};
use crate::{Mat3, Vec3};
use lacuna_interfaces::BadInput;
use lacuna_interfaces::robot::JointType;
use roxmltree::{Document, Node};
use std::collections::BTreeMap;

/// Type of a URDF joint as far as a chain can hold it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Fixed,
    Movable(JointType),
    /// Floating, planar or anything unknown.
    Other,
}

#[derive(Debug)]
struct UrdfJoint<'a> {
    name: &'a str,
    /// Type as written.
    type_name: &'a str,
    kind: Kind,
    parent: &'a str,
    child: &'a str,
    origin: Placement,
    axis: Vec3,
    line: u64,
}

/// All links and joints by name.
struct Tree<'a> {
    bodies: BTreeMap<&'a str, Body>,
    joints: BTreeMap<&'a str, UrdfJoint<'a>>,
    /// Joint that carries a link.
    carrier: BTreeMap<&'a str, &'a str>,
}

/// Segments of the chain of `names`, base first, and the tip frame in the last link's frame.
///
/// # Errors
/// [`BadInput`] with the line of the element: broken XML, missing or malformed numbers, a name that is not a
/// revolute, continuous or prismatic joint, joints that do not follow one another, movable joints left out.
pub fn read(text: &str, names: &[String]) -> Result<(Vec<Segment>, Placement), BadInput> {
    let doc = Document::parse(text).map_err(|e| {
        BadInput::new(format!("found {}; expected well-formed XML", one_line(&e.to_string())))
            .at_line(e.pos().row.into())
    })?;
    let tree = Tree::parse(&doc)?;
    let mut segments = Vec::with_capacity(names.len());
    let mut previous: Option<&UrdfJoint<'_>> = None;
    // All names first: a misspelt one is the likelier reason for a joint that seems left out.
    let chain = names.iter().map(|name| tree.movable(name)).collect::<Result<Vec<_>, _>>()?;
    for joint in chain {
        let (kind, before) = tree.placement(joint, previous)?;
        segments.push(Segment {
            kind,
            before,
            axis: joint.axis,
            after: Placement::IDENTITY,
            body: tree.rigid_part(joint.child, names)?,
            rotor: 0.0,
        });
        previous = Some(joint);
    }
    let tip = previous.map_or(Placement::IDENTITY, |last| tree.flange(last.child));
    Ok((segments, tip))
}

impl<'a> Tree<'a> {
    fn parse(doc: &'a Document<'_>) -> Result<Self, BadInput> {
        let root = doc.root_element();
        if root.tag_name().name() != "robot" {
            return Err(bad(root, format!("found <{}>; expected <robot>", root.tag_name().name())));
        }
        let mut tree = Self { bodies: BTreeMap::new(), joints: BTreeMap::new(), carrier: BTreeMap::new() };
        for node in root.children().filter(Node::is_element) {
            let tag = node.tag_name();
            if tag.namespace().is_some_and(|n| n.contains("xacro")) {
                return Err(bad(
                    node,
                    format!("found <xacro:{}>; expected a URDF without macros: run xacro first", tag.name()),
                ));
            }
            match tag.name() {
                "link" => tree.add_link(node)?,
                "joint" => tree.add_joint(node)?,
                _ => {}
            }
        }
        for joint in tree.joints.values() {
            for link in [joint.parent, joint.child] {
                if !tree.bodies.contains_key(link) {
                    let what =
                        format!("joint '{}': link '{link}' does not exist; expected a link of this file", joint.name);
                    return Err(BadInput::new(what).at_line(joint.line));
                }
            }
        }
        Ok(tree)
    }

    fn add_link(&mut self, node: Node<'a, '_>) -> Result<(), BadInput> {
        let name = attribute(node, "name")?;
        let body = match child(node, "inertial") {
            Some(inertial) => body_of(inertial)?,
            None => Body::NONE,
        };
        match self.bodies.insert(name, body) {
            Some(_) => Err(bad(node, format!("link '{name}' is given twice; expected distinct names"))),
            None => Ok(()),
        }
    }

    fn add_joint(&mut self, node: Node<'a, '_>) -> Result<(), BadInput> {
        let (name, type_name) = (attribute(node, "name")?, attribute(node, "type")?);
        let link_of = |tag: &str| {
            let element =
                child(node, tag).ok_or_else(|| bad(node, format!("joint '{name}': found no <{tag}>; expected one")))?;
            attribute(element, "link")
        };
        let kind = match type_name {
            "fixed" => Kind::Fixed,
            "revolute" | "continuous" => Kind::Movable(JointType::Revolute),
            "prismatic" => Kind::Movable(JointType::Prismatic),
            _ => Kind::Other,
        };
        let joint = UrdfJoint {
            name,
            type_name,
            kind,
            parent: link_of("parent")?,
            child: link_of("child")?,
            origin: origin_of(node)?,
            axis: axis_of(node)?,
            line: line_of(node),
        };
        if let Some(other) = self.carrier.insert(joint.child, name) {
            return Err(bad(
                node,
                format!("link '{}' is the child of '{other}' and of '{name}'; expected a tree", joint.child),
            ));
        }
        match self.joints.insert(name, joint) {
            Some(_) => Err(bad(node, format!("joint '{name}' is given twice; expected distinct names"))),
            None => Ok(()),
        }
    }

    fn movable(&self, name: &str) -> Result<&UrdfJoint<'a>, BadInput> {
        let Some(joint) = self.joints.get(name) else {
            let known: Vec<&str> = self.joints.values().filter(|j| j.kind != Kind::Fixed).map(|j| j.name).collect();
            return Err(BadInput::new(format!(
                "joint '{name}' is not in the URDF; its movable joints are {}",
                known.join(", ")
            )));
        };
        match joint.kind {
            Kind::Movable(_) => Ok(joint),
            Kind::Fixed | Kind::Other => Err(BadInput::new(format!(
                "joint '{name}' is of type \"{}\"; expected revolute, continuous or prismatic",
                joint.type_name
            ))
            .at_line(joint.line)),
        }
    }

    /// Joint frame of `joint` in the frame of the link behind `previous` (of the root link without one).
    fn placement(
        &self,
        joint: &UrdfJoint<'a>,
        previous: Option<&UrdfJoint<'a>>,
    ) -> Result<(JointType, Placement), BadInput> {
        let Kind::Movable(kind) = joint.kind else { return Err(BadInput::new("joint is not movable")) };
        let mut place = joint.origin;
        let mut link = joint.parent;
        // A tree has no path longer than its joints; a longer one runs in a circle.
        for _ in 0..=self.joints.len() {
            if previous.is_some_and(|p| p.child == link) {
                return Ok((kind, place));
            }
            let Some(carrier) = self.carrier.get(link).and_then(|name| self.joints.get(name)) else {
                let Some(p) = previous else { return Ok((kind, place)) };
                return Err(BadInput::new(format!(
                    "joint '{}' does not follow '{}': found link '{link}' at the root; expected the joints in chain order",
                    joint.name, p.name
                ))
                .at_line(joint.line));
            };
            if carrier.kind != Kind::Fixed {
                return Err(BadInput::new(format!(
                    "joint '{}' hangs on the {} joint '{}'; expected {}",
                    joint.name,
                    carrier.type_name,
                    carrier.name,
                    previous.map_or("the robot file to name that one first".to_owned(), |p| format!(
                        "'{}' right before it, as the robot file orders them",
                        p.name
                    ))
                ))
                .at_line(joint.line));
            }
            place = carrier.origin.then(&place);
            link = carrier.parent;
        }
        Err(BadInput::new(format!("joint '{}' is part of a closed loop; expected a tree", joint.name))
            .at_line(joint.line))
    }

    /// Body of a link and of everything fixed to it, in the link's frame.
    fn rigid_part(&self, link: &'a str, names: &[String]) -> Result<Body, BadInput> {
        let mut sum = Body::NONE;
        let mut open = vec![(link, Placement::IDENTITY)];
        // Each link has one carrier, so only a circle can be longer than the list of links.
        for _ in 0..=self.bodies.len() {
            let Some((link, place)) = open.pop() else { return Ok(sum) };
            if let Some(body) = self.bodies.get(link) {
                sum = sum.with(&body.seen_through(&place));
            }
            for joint in self.joints.values().filter(|j| j.parent == link) {
                if joint.kind == Kind::Fixed {
                    open.push((joint.child, place.then(&joint.origin)));
                } else if !names.iter().any(|n| n == joint.name) {
                    return Err(BadInput::new(format!(
                        "the {} joint '{}' moves with the chain but the robot file does not name it; expected it named, or fixed",
                        joint.type_name, joint.name
                    ))
                    .at_line(joint.line));
                }
            }
        }
        Err(BadInput::new(format!("link '{link}' is part of a closed loop; expected a tree")))
    }

    /// Frame behind `link` as long as exactly one fixed joint leads on.
    fn flange(&self, link: &'a str) -> Placement {
        let (mut place, mut link) = (Placement::IDENTITY, link);
        for _ in 0..self.joints.len() {
            let mut next = self.joints.values().filter(|j| j.parent == link);
            let (Some(joint), None) = (next.next(), next.next()) else { break };
            place = place.then(&joint.origin);
            link = joint.child;
        }
        place
    }
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

fn line_of(node: Node<'_, '_>) -> u64 {
    node.document().text_pos_at(node.range().start).row.into()
}

fn bad(node: Node<'_, '_>, what: impl Into<String>) -> BadInput {
    BadInput::new(one_line(&what.into())).at_line(line_of(node))
}

fn child<'a, 'i>(node: Node<'a, 'i>, tag: &str) -> Option<Node<'a, 'i>> {
    node.children().find(|c| c.has_tag_name(tag))
}

fn attribute<'a>(node: Node<'a, '_>, name: &str) -> Result<&'a str, BadInput> {
    node.attribute(name).ok_or_else(|| bad(node, format!("<{}> has no {name}; expected one", node.tag_name().name())))
}

fn number(node: Node<'_, '_>, name: &str) -> Result<f64, BadInput> {
    finite(node, name, attribute(node, name)?.trim())
}

fn finite(node: Node<'_, '_>, name: &str, text: &str) -> Result<f64, BadInput> {
    match text.parse::<f64>() {
        Ok(v) if v.is_finite() => Ok(v),
        _ => Err(bad(node, format!("<{}> {name}: found \"{text}\"; expected a finite number", node.tag_name().name()))),
    }
}

/// Three numbers of an attribute; zeros if it is absent, as the URDF format defines.
fn triple(node: Node<'_, '_>, name: &str) -> Result<Vec3, BadInput> {
    let Some(text) = node.attribute(name) else { return Ok(Vec3::zeros()) };
    let values = text.split_whitespace().map(|t| finite(node, name, t)).collect::<Result<Vec<f64>, _>>()?;
    match values[..] {
        [x, y, z] => Ok(Vec3::new(x, y, z)),
        _ => Err(bad(node, format!("<{}> {name}: found {} numbers; expected 3", node.tag_name().name(), values.len()))),
    }
}

/// `<origin xyz rpy>`: R = Rz(yaw) Ry(pitch) Rx(roll).
fn origin_of(node: Node<'_, '_>) -> Result<Placement, BadInput> {
    let Some(origin) = child(node, "origin") else { return Ok(Placement::IDENTITY) };
    let rpy = triple(origin, "rpy")?;
    Ok(Placement { rotation: about(2, rpy.z) * about(1, rpy.y) * about(0, rpy.x), position: triple(origin, "xyz")? })
}

/// `<axis xyz>` made a unit vector; x if absent, as the URDF format defines.
fn axis_of(node: Node<'_, '_>) -> Result<Vec3, BadInput> {
    let Some(axis) = child(node, "axis") else { return Ok(Vec3::x()) };
    let v = match axis.attribute("xyz") {
        Some(_) => triple(axis, "xyz")?,
        None => Vec3::x(),
    };
    // Some exporters write a zero axis for fixed joints, where it has no meaning.
    if node.attribute("type") == Some("fixed") {
        return Ok(Vec3::x());
    }
    v.try_normalize(1e-9).ok_or_else(|| bad(axis, "<axis> xyz: found a zero vector; expected a direction"))
}

fn body_of(inertial: Node<'_, '_>) -> Result<Body, BadInput> {
    let element = |tag: &str| {
        child(inertial, tag).ok_or_else(|| bad(inertial, format!("<inertial> has no <{tag}>; expected one")))
    };
    let mass_node = element("mass")?;
    let mass = number(mass_node, "value")?;
    if mass < 0.0 {
        return Err(bad(mass_node, format!("<mass> value: found {mass}; expected zero or more")));
    }
    let i = element("inertia")?;
    let [xx, xy, xz] = [number(i, "ixx")?, number(i, "ixy")?, number(i, "ixz")?];
    let [yy, yz, zz] = [number(i, "iyy")?, number(i, "iyz")?, number(i, "izz")?];
    let place = origin_of(inertial)?;
    let about_com = Mat3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
    Ok(Body::new(mass, Vec3::zeros(), about_com).seen_through(&place))
}
