//! Writes inertials into a URDF: the text as it is, with the bodies of a chain's links, and the friction of its joints,
//! replaced.
//!
//! A moving link and everything fixed to it are one body to the joint's torque. The whole body goes into the moving link;
//! the inertials of what is fixed to it are taken out. A URDF has no place for rotor inertia: it is stated in a comment.

use super::super::PER_LINK;
use super::super::chain::Body;
use super::{Kind, Tree, child};
use crate::{Mat3, Vec3};
use lacuna_interfaces::BadInput;
use roxmltree::{Document, Node};
use std::fmt::Write as _;
use std::ops::Range;

/// What is known of a moving link and its joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinkValues {
    /// The link with everything fixed to it, in the link's frame.
    pub body: Body,
    /// Rotor and gear inertia at the joint side [kg m²; prismatic: kg].
    pub rotor: f64,
    /// Viscous and Coulomb friction of the joint [Nm s/rad, Nm]; `None` leaves `<dynamics>` as it is.
    pub friction: Option<(f64, f64)>,
}

impl LinkValues {
    /// Links from a chain's parameter vector, without friction.
    pub fn of_parameters(pi: &[f64]) -> Vec<Self> {
        let link = |p: &[f64; PER_LINK]| {
            let [mass, x, y, z, xx, xy, xz, yy, yz, zz, rotor] = *p;
            let inertia = Mat3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
            Self { body: Body { mass, moment: Vec3::new(x, y, z), inertia }, rotor, friction: None }
        };
        pi.chunks_exact(PER_LINK).filter_map(|p| p.try_into().ok()).map(link).collect()
    }
}

/// The URDF `text` with the links behind the joints `names` as `links` has them. `remarks` go into a comment at its top,
/// with what the file cannot hold.
///
/// # Errors
/// [`BadInput`] if the text cannot be read, names and links do not match, or a body could not exist: its mass or one of
/// its moments is not positive.
pub fn with_inertials(
    text: &str,
    names: &[String],
    links: &[LinkValues],
    remarks: &[String],
) -> Result<String, BadInput> {
    if names.len() != links.len() {
        return Err(BadInput::new(format!(
            "found {} links for {} joints; expected one each",
            links.len(),
            names.len()
        )));
    }
    let doc = Document::parse(text).map_err(|e| BadInput::new(format!("found {e}; expected well-formed XML")))?;
    let tree = Tree::parse(&doc)?;
    let mut edits = vec![(start_of(doc.root_element()), comment(names, links, remarks))];
    for (name, values) in names.iter().zip(links) {
        let joint = tree.movable(name)?;
        let of = |what: &str, name: &str| named(&doc, what, name);
        let link = of("link", joint.child)?;
        let inertial =
            inertial(&values.body).map_err(|what| BadInput::new(format!("link '{}': {what}", joint.child)))?;
        edits.push(put(text, link, "inertial", &inertial));
        for fixed in behind(&tree, joint.child) {
            let node = of("link", fixed)?;
            let remark = format!("<!-- inertia: part of link {} -->", plain(joint.child));
            edits.extend(child(node, "inertial").map(|old| (old.range(), remark)));
        }
        if let Some((viscous, coulomb)) = values.friction {
            let dynamics = format!("<dynamics damping=\"{viscous}\" friction=\"{coulomb}\"/>");
            edits.push(put(text, of("joint", name)?, "dynamics", &dynamics));
        }
    }
    edits.sort_by_key(|(range, _)| range.start);
    let (mut out, mut done) = (String::with_capacity(text.len() + 4096), 0);
    for (range, new) in edits {
        out.push_str(text.get(done..range.start).unwrap_or_default());
        out.push_str(&new);
        done = range.end;
    }
    out.push_str(text.get(done..).unwrap_or_default());
    Ok(out)
}

/// Links that are fixed to `link`, at any distance.
fn behind<'a>(tree: &Tree<'a>, link: &'a str) -> Vec<&'a str> {
    let mut found = Vec::new();
    let mut open = vec![link];
    // Each link has one carrier, so only a circle is longer than the list of links.
    for _ in 0..=tree.bodies.len() {
        let Some(link) = open.pop() else { break };
        for joint in tree.joints.values().filter(|j| j.parent == link && j.kind == Kind::Fixed) {
            found.push(joint.child);
            open.push(joint.child);
        }
    }
    found
}

fn named<'a, 'i>(doc: &'a Document<'i>, tag: &str, name: &str) -> Result<Node<'a, 'i>, BadInput> {
    let mut found = doc.root_element().children().filter(|n| n.has_tag_name(tag) && n.attribute("name") == Some(name));
    found.next().ok_or_else(|| BadInput::new(format!("found no {tag} '{name}'; expected one")))
}

/// Where the contents of an element begin: at its first child.
fn start_of(node: Node<'_, '_>) -> Range<usize> {
    let at = node.first_child().map_or(node.range().end, |c| c.range().start);
    at..at
}

/// The edit that makes `new` the element's child of this tag: in place of the present one, else before its end.
fn put(text: &str, node: Node<'_, '_>, tag: &str, new: &str) -> (Range<usize>, String) {
    if let Some(old) = child(node, tag) {
        return (old.range(), new.to_owned());
    }
    let range = node.range();
    let own = text.get(range.clone()).unwrap_or_default();
    let end = own.rfind('<').map_or(range.end, |i| range.start + i);
    match own.strip_suffix("/>") {
        // An element without contents, like <link name="a"/>: it gets an end of its own.
        Some(open) if !node.has_children() => {
            let at = range.start + open.len();
            (at..range.end, format!(">{new}</{}>", node.tag_name().name()))
        }
        _ => (end..end, format!("{new}\n")),
    }
}

/// `<inertial>` of a body, with a frame at its centre of mass and parallel to the link's.
fn inertial(body: &Body) -> Result<String, String> {
    let Body { mass, moment, inertia } = body;
    if !(mass.is_finite() && *mass > 0.0) {
        return Err(format!("found a mass of {mass} kg; expected above zero"));
    }
    let com = moment / *mass;
    let s = com.cross_matrix();
    let about_com = inertia + *mass * s * s;
    // Second moments ∫ r rᵀ dm: positive exactly if moments of inertia are, triangle inequality included.
    let spread = Mat3::identity() * (0.5 * about_com.trace()) - about_com;
    if spread.cholesky().is_none() {
        let worst = spread.symmetric_eigen().eigenvalues.min();
        return Err(format!("found a second moment of {worst:.3e} kg m²; expected above zero in every direction"));
    }
    let [c, i] = [com, about_com.diagonal()];
    Ok(format!(
        "<inertial>\n      <origin xyz=\"{} {} {}\" rpy=\"0 0 0\"/>\n      <mass value=\"{mass}\"/>\n      \
         <inertia ixx=\"{}\" ixy=\"{}\" ixz=\"{}\" iyy=\"{}\" iyz=\"{}\" izz=\"{}\"/>\n    </inertial>",
        c.x, c.y, c.z, i.x, about_com.m12, about_com.m13, i.y, about_com.m23, i.z
    ))
}

fn comment(names: &[String], links: &[LinkValues], remarks: &[String]) -> String {
    let mut out = String::from("\n  <!--\n");
    // Writing to a String cannot fail.
    for remark in remarks {
        let _ = writeln!(out, "    {}", plain(remark));
    }
    out.push_str("    The inertia of links that are fixed to a moving link is part of that link.\n");
    if links.iter().any(|l| l.rotor != 0.0) {
        out.push_str("    A URDF has no rotor inertia. Add at the joint side (armature; kg m², prismatic kg):\n");
        for (name, link) in names.iter().zip(links) {
            let _ = writeln!(out, "      {} {}", plain(name), link.rotor);
        }
    }
    out.push_str("  -->");
    out
}

/// Text as a comment may hold it: without two hyphens in a row.
fn plain(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        if c == '-' && out.ends_with('-') {
            out.push(' ');
        }
        out.push(c);
    }
    if out.ends_with('-') {
        out.push(' ');
    }
    out
}
