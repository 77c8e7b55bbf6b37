//! `robot.toml`: what is known of a robot before any recording is read.
//!
//! `kind = "delta"` gives geometry and the masses of the paper's model M_KH; `kind = "serial"` gives a URDF
//! path or `[[dh]]` rows (classic: Rz(q + offset) Tz(d) Tx(a) Rx(alpha)). SI units; `alpha_deg` alone is in
//! degrees because leg directions are written that way.

use crate::columns::Columns;
use crate::ethercat::Ethercat;
use crate::{BadInput, MAX_JOINTS};
use serde::{Deserialize, Serialize};

/// Which mechanics.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// Three-leg Delta with a translating platform.
    Delta,
    /// Open chain of 1 to 8 joints.
    Serial,
}

/// Unit of the torque signal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum TorqueUnit {
    /// Newton metres at the joint (prismatic: N).
    #[default]
    Nm,
    /// Motor current [A].
    A,
    /// Motor voltage [V].
    V,
}

impl TorqueUnit {
    /// The unit's symbol.
    pub fn symbol(self) -> &'static str {
        match self {
            Self::Nm => "Nm",
            Self::A => "A",
            Self::V => "V",
        }
    }
}

/// Delta geometry (paper, section 2).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Geometry {
    /// Upper arm length l1 [m].
    pub l1: f64,
    /// Forearm length l2 [m].
    pub l2: f64,
    /// Base radius r_a [m].
    pub ra: f64,
    /// Platform radius r_b [m].
    pub rb: f64,
    /// Leg directions α_i [deg].
    #[serde(default = "default_alpha")]
    pub alpha_deg: [f64; 3],
}

fn default_alpha() -> [f64; 3] {
    [0.0, 120.0, 240.0]
}

/// Delta masses of M_KH.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mass {
    /// Platform m0 [kg].
    pub platform: f64,
    /// Upper arm m1, a uniform rod [kg].
    pub upper_arm: f64,
    /// Forearm point mass m2 at the elbow and the same again at the platform, per leg [kg].
    pub forearm_point: f64,
    /// Rotor and gear inertia J_r per joint, at the joint side [kg m²].
    #[serde(default)]
    pub rotor_inertia: f64,
}

/// Joint type of a DH row.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum JointType {
    /// Turns about z.
    #[default]
    Revolute,
    /// Slides along z.
    Prismatic,
}

/// One classic DH row: Rz(q + offset) Tz(d) Tx(a) Rx(alpha); a prismatic joint adds q to d instead.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DhRow {
    /// Link length [m].
    #[serde(default)]
    pub a: f64,
    /// Link offset [m].
    #[serde(default)]
    pub d: f64,
    /// Twist [rad].
    #[serde(default)]
    pub alpha: f64,
    /// Joint angle at q = 0 [rad].
    #[serde(default)]
    pub offset: f64,
    /// Joint type.
    #[serde(default)]
    pub joint: JointType,
}

/// Inertia of one link of a DH chain, in the link's own DH frame. All zero (unknown) unless given.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinkInertia {
    /// Mass [kg].
    #[serde(default)]
    pub mass: f64,
    /// Centre of mass [m].
    #[serde(default)]
    pub com: [f64; 3],
    /// Inertia about the centre of mass [kg m²]: Ixx, Ixy, Ixz, Iyy, Iyz, Izz.
    #[serde(default)]
    pub inertia: [f64; 6],
    /// Rotor and gear inertia at the joint side [kg m²].
    #[serde(default)]
    pub rotor_inertia: f64,
}

/// Surroundings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Env {
    /// Gravity in the base frame [m/s²].
    pub gravity: [f64; 3],
}

impl Default for Env {
    fn default() -> Self {
        Self { gravity: [0.0, 0.0, -9.81] }
    }
}

/// One value for all joints, or one per joint.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum PerJoint {
    /// The same for every joint.
    All(f64),
    /// One per joint.
    Each(Vec<f64>),
}

impl PerJoint {
    /// Value of joint `i`; `None` beyond the given ones.
    pub fn get(&self, i: usize) -> Option<f64> {
        match self {
            Self::All(v) => Some(*v),
            Self::Each(v) => v.get(i).copied(),
        }
    }
}

/// Drives.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Drive {
    /// Motor turns per joint turn, with sign.
    pub gear_ratio: Option<PerJoint>,
    /// Encoder resolution [bit], motor side.
    pub encoder_bits: Option<PerJoint>,
    /// Nominal sample rate of recordings [Hz].
    pub sample_rate_hz: Option<f64>,
    /// Motor pole pairs.
    pub pole_pairs: Option<PerJoint>,
    /// Stator slots.
    pub slots: Option<PerJoint>,
    /// Rated torque at the joint side [Nm].
    pub rated_torque_nm: Option<PerJoint>,
}

/// Motion limits, for excitation design.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Limits {
    /// Lowest position [rad].
    pub q_min_rad: Option<PerJoint>,
    /// Highest position [rad].
    pub q_max_rad: Option<PerJoint>,
    /// Highest speed [rad/s].
    pub qd_max_rad_s: Option<PerJoint>,
    /// Highest acceleration [rad/s²].
    pub qdd_max_rad_s2: Option<PerJoint>,
}

/// How far the real robot may be from this file before it counts as a finding.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tolerance {
    /// Relative tolerance of masses and inertias.
    #[serde(default = "default_tolerance")]
    pub mass: f64,
    /// Relative tolerance of lengths.
    #[serde(default = "default_tolerance")]
    pub length: f64,
}

fn default_tolerance() -> f64 {
    0.02
}

impl Default for Tolerance {
    fn default() -> Self {
        Self { mass: default_tolerance(), length: default_tolerance() }
    }
}

/// The whole file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotFile {
    /// Mechanics.
    pub kind: Kind,
    /// Name for reports.
    pub name: String,
    /// Joint names; a Delta that gives none gets q1, q2, q3.
    #[serde(default)]
    pub joints: Vec<String>,
    /// Unit of the torque columns.
    #[serde(default)]
    pub torque_unit: TorqueUnit,
    /// Delta geometry.
    pub geometry: Option<Geometry>,
    /// Delta masses.
    pub mass: Option<Mass>,
    /// URDF path of a serial arm, relative to this file.
    pub urdf: Option<String>,
    /// DH rows of a serial arm.
    #[serde(default)]
    pub dh: Vec<DhRow>,
    /// Link inertias of a DH chain, as many as rows or none.
    #[serde(default)]
    pub link: Vec<LinkInertia>,
    /// Gravity.
    #[serde(default)]
    pub env: Env,
    /// Drives.
    #[serde(default)]
    pub drive: Drive,
    /// Columns of tables.
    #[serde(default)]
    pub columns: Columns,
    /// Motion limits.
    #[serde(default)]
    pub limits: Limits,
    /// Tolerances of the nominal values.
    #[serde(default)]
    pub tolerance: Tolerance,
    /// Where a capture of the fieldbus holds the drives' signals.
    pub ethercat: Option<Ethercat>,
}

impl RobotFile {
    /// Parses and checks a robot file.
    ///
    /// # Errors
    /// [`BadInput`] with the line for syntax, unknown keys and missing keys; without a line for values that
    /// do not fit together.
    pub fn parse(text: &str) -> Result<Self, BadInput> {
        let mut robot: Self = toml::from_str(text).map_err(|e| BadInput::from_toml(&e, text))?;
        if robot.kind == Kind::Delta && robot.joints.is_empty() {
            robot.joints = ["q1", "q2", "q3"].map(str::to_owned).to_vec();
        }
        robot.validate()?;
        Ok(robot)
    }

    /// Number of joints.
    pub fn joint_count(&self) -> usize {
        self.joints.len()
    }

    /// Number of joints, as many as a message holds.
    ///
    /// # Errors
    /// [`BadInput`] for none, or more than [`MAX_JOINTS`].
    pub fn message_joints(&self) -> Result<usize, BadInput> {
        let n = self.joint_count();
        if (1..=MAX_JOINTS).contains(&n) {
            return Ok(n);
        }
        Err(BadInput::new(format!("robot: found {n} joints; expected 1 to {MAX_JOINTS}")))
    }

    /// Checks that the values fit together.
    ///
    /// # Errors
    /// [`BadInput`] naming the key, the value found and what was expected.
    pub fn validate(&self) -> Result<(), BadInput> {
        let n = self.joint_count();
        match self.kind {
            Kind::Delta => self.validate_delta(n)?,
            Kind::Serial => self.validate_serial(n)?,
        }
        if n == 0 || n > MAX_JOINTS {
            return Err(BadInput::new(format!("joints: found {n} names; expected 1 to {MAX_JOINTS}")));
        }
        for (i, name) in self.joints.iter().enumerate() {
            if name.is_empty() || self.joints[..i].contains(name) {
                return Err(BadInput::new(format!(
                    "joints: name '{name}' is empty or given twice; expected distinct names"
                )));
            }
        }
        finite("env.gravity", &self.env.gravity)?;
        self.validate_drive(n)?;
        self.columns.validate(n)?;
        for (key, v) in [("tolerance.mass", self.tolerance.mass), ("tolerance.length", self.tolerance.length)] {
            if !(v.is_finite() && (0.0..1.0).contains(&v)) {
                return Err(BadInput::new(format!("{key}: found {v}; expected a fraction from 0 to below 1")));
            }
        }
        self.ethercat.as_ref().map_or(Ok(()), |table| table.validate(self))
    }

    fn validate_delta(&self, n: usize) -> Result<(), BadInput> {
        let missing = |key| BadInput::new(format!("[{key}] is missing; a robot of kind \"delta\" needs it"));
        let g = self.geometry.as_ref().ok_or_else(|| missing("geometry"))?;
        let m = self.mass.as_ref().ok_or_else(|| missing("mass"))?;
        if n != 3 {
            return Err(BadInput::new(format!("joints: found {n} names; expected 3 for kind \"delta\"")));
        }
        if self.urdf.is_some() || !self.dh.is_empty() || !self.link.is_empty() {
            return Err(BadInput::new(
                "urdf, dh and link belong to kind \"serial\"; found one of them with kind \"delta\"",
            ));
        }
        for (key, v) in [
            ("geometry.l1", g.l1),
            ("geometry.l2", g.l2),
            ("geometry.ra", g.ra),
            ("geometry.rb", g.rb),
            ("mass.platform", m.platform),
        ] {
            if !(v.is_finite() && v > 0.0) {
                return Err(BadInput::new(format!("{key}: found {v}; expected a positive number")));
            }
        }
        for (key, v) in [
            ("mass.upper_arm", m.upper_arm),
            ("mass.forearm_point", m.forearm_point),
            ("mass.rotor_inertia", m.rotor_inertia),
        ] {
            if !(v.is_finite() && v >= 0.0) {
                return Err(BadInput::new(format!("{key}: found {v}; expected zero or a positive number")));
            }
        }
        finite("geometry.alpha_deg", &g.alpha_deg)?;
        for i in 0..3 {
            let gap = (g.alpha_deg[i] - g.alpha_deg[(i + 1) % 3]).rem_euclid(360.0);
            if gap.min(360.0 - gap) < 1.0 {
                return Err(BadInput::new(format!(
                    "geometry.alpha_deg: found {:?}; expected three distinct directions",
                    g.alpha_deg
                )));
            }
        }
        if g.l2 <= g.l1 {
            return Err(BadInput::new(format!(
                "geometry: found l2 = {} and l1 = {}; expected the forearm longer than the upper arm",
                g.l2, g.l1
            )));
        }
        Ok(())
    }

    fn validate_serial(&self, n: usize) -> Result<(), BadInput> {
        if self.geometry.is_some() || self.mass.is_some() {
            return Err(BadInput::new(
                "[geometry] and [mass] belong to kind \"delta\"; found one of them with kind \"serial\"",
            ));
        }
        match (&self.urdf, self.dh.is_empty()) {
            (Some(_), false) => return Err(BadInput::new("found both urdf and [[dh]]; expected one of them")),
            (None, true) => {
                return Err(BadInput::new("found neither urdf nor [[dh]]; kind \"serial\" needs one of them"));
            }
            _ => {}
        }
        if self.urdf.is_none() && self.dh.len() != n {
            return Err(BadInput::new(format!(
                "found {} [[dh]] rows for {n} joints; expected one row per joint",
                self.dh.len()
            )));
        }
        if !self.link.is_empty() && (self.urdf.is_some() || self.link.len() != n) {
            return Err(BadInput::new(format!(
                "found {} [[link]] tables; expected none with a URDF, else one per joint ({n})",
                self.link.len()
            )));
        }
        for (i, row) in self.dh.iter().enumerate() {
            finite(&format!("dh[{i}]"), &[row.a, row.d, row.alpha, row.offset])?;
        }
        for (i, l) in self.link.iter().enumerate() {
            finite(&format!("link[{i}]"), &[l.mass, l.rotor_inertia])?;
            finite(&format!("link[{i}].com"), &l.com)?;
            finite(&format!("link[{i}].inertia"), &l.inertia)?;
            if l.mass < 0.0 || l.rotor_inertia < 0.0 {
                return Err(BadInput::new(format!(
                    "link[{i}]: found a negative mass or rotor inertia; expected zero or more"
                )));
            }
        }
        Ok(())
    }

    fn validate_drive(&self, n: usize) -> Result<(), BadInput> {
        let d = &self.drive;
        let l = &self.limits;
        for (key, value, signed) in [
            ("drive.gear_ratio", &d.gear_ratio, true),
            ("drive.encoder_bits", &d.encoder_bits, false),
            ("drive.pole_pairs", &d.pole_pairs, false),
            ("drive.slots", &d.slots, false),
            ("drive.rated_torque_nm", &d.rated_torque_nm, false),
            ("limits.q_min_rad", &l.q_min_rad, true),
            ("limits.q_max_rad", &l.q_max_rad, true),
            ("limits.qd_max_rad_s", &l.qd_max_rad_s, false),
            ("limits.qdd_max_rad_s2", &l.qdd_max_rad_s2, false),
        ] {
            let Some(value) = value else { continue };
            if let PerJoint::Each(v) = value
                && v.len() != n
            {
                return Err(BadInput::new(format!(
                    "{key}: found {} values; expected one, or one per joint ({n})",
                    v.len()
                )));
            }
            let zero_ok = key.starts_with("limits.q_m");
            for i in 0..n {
                let v = value.get(i).unwrap_or(f64::NAN);
                if !v.is_finite() || (!signed && v <= 0.0) || (signed && !zero_ok && v == 0.0) {
                    return Err(BadInput::new(format!(
                        "{key}: found {v}; expected a {} number",
                        if signed { "finite, non-zero" } else { "positive" }
                    )));
                }
            }
        }
        if let Some(rate) = d.sample_rate_hz
            && !(rate.is_finite() && rate > 0.0)
        {
            return Err(BadInput::new(format!("drive.sample_rate_hz: found {rate}; expected a positive number")));
        }
        for i in 0..n {
            if let (Some(lo), Some(hi)) =
                (l.q_min_rad.as_ref().and_then(|p| p.get(i)), l.q_max_rad.as_ref().and_then(|p| p.get(i)))
                && lo >= hi
            {
                return Err(BadInput::new(format!(
                    "limits: joint {} has q_min_rad {lo} and q_max_rad {hi}; expected min below max",
                    self.joints[i]
                )));
            }
        }
        Ok(())
    }
}

fn finite(key: &str, values: &[f64]) -> Result<(), BadInput> {
    match values.iter().find(|v| !v.is_finite()) {
        Some(v) => Err(BadInput::new(format!("{key}: found {v}; expected finite numbers"))),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DELTA: &str = "kind = \"delta\"\nname = \"d\"\n[geometry]\nl1 = 0.35\nl2 = 0.88\nra = 0.2\nrb = 0.05\n\
        [mass]\nplatform = 1.1\nupper_arm = 1.8\nforearm_point = 0.22\n[drive]\ngear_ratio = 33\n";

    #[test]
    fn delta_defaults() {
        let robot = RobotFile::parse(DELTA).unwrap();
        assert_eq!(robot.joints, ["q1", "q2", "q3"]);
        assert_eq!(robot.torque_unit, TorqueUnit::Nm);
        assert_eq!(robot.drive.gear_ratio.unwrap().get(2), Some(33.0));
        assert_eq!(robot.env.gravity, [0.0, 0.0, -9.81]);
    }

    #[test]
    fn errors_name_line_and_expectation() {
        let unknown = format!("{DELTA}geer_ratio = 3\n");
        let e = RobotFile::parse(&unknown).unwrap_err();
        assert_eq!(e.line, Some(14), "{e}");
        assert!(e.what.contains("geer_ratio"), "{e}");
        for (from, to, expect) in [
            ("l1 = 0.35", "l1 = nan", "positive"),
            ("l1 = 0.35", "l1 = 0.95", "longer"),
            ("kind = \"delta\"", "kind = \"serial\"", "delta"),
            ("kind = \"delta\"", "kind = \"scara\"", "scara"),
            ("gear_ratio = 33", "gear_ratio = [33, 33]", "per joint"),
        ] {
            let e = RobotFile::parse(&DELTA.replace(from, to)).unwrap_err();
            assert!(e.what.contains(expect), "{to}: {e}");
            assert!(!e.to_string().contains('\n'), "{e}");
        }
    }
}
