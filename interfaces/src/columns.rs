//! `[columns]` of a robot file: which columns of a table hold what, and in which unit.
//!
//! A table of ours needs none of it: `t` in seconds, `q1`… in rad, `tau1`… in the robot file's `torque_unit`. For
//! tables of others:
//!
//! ```toml
//! [columns]
//! time = "Time"
//! time_unit = "ms"
//! position = ["Axis1.ActPos", "Axis2.ActPos"]
//! position_unit = "deg"              # or one per joint: ["deg", "mm"]
//! torque = ["Axis1.Trq", "Axis2.Trq"]
//! torque_scale = [1.8, -1.8]         # column × scale = torque at the joint
//! joints = ["axis_1", "axis_2"]      # as messages name them, where not as this file does
//! ```

use crate::BadInput;
use crate::robot::PerJoint;
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};

/// Unit of a time column.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TimeUnit {
    /// Seconds.
    #[default]
    S,
    /// Milliseconds.
    Ms,
    /// Microseconds.
    Us,
    /// Nanoseconds.
    Ns,
}

impl TimeUnit {
    /// Decimal places of this unit down to a nanosecond.
    pub fn decimals(self) -> u32 {
        match self {
            Self::S => 9,
            Self::Ms => 6,
            Self::Us => 3,
            Self::Ns => 0,
        }
    }

    fn is_default(&self) -> bool {
        *self == Self::S
    }
}

/// Unit of a position column.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PositionUnit {
    /// Radians.
    #[default]
    Rad,
    /// Degrees.
    Deg,
    /// Whole turns.
    Turn,
    /// Metres, of a prismatic joint.
    M,
    /// Millimetres, of a prismatic joint.
    Mm,
}

impl PositionUnit {
    /// How many rad (prismatic: m) one of it is.
    pub fn factor(self) -> f64 {
        match self {
            Self::Rad | Self::M => 1.0,
            Self::Deg => PI / 180.0,
            Self::Turn => TAU,
            Self::Mm => 1e-3,
        }
    }
}

/// One unit for all joints, or one per joint.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged, expecting = "expected rad, deg, turn, m or mm, or a list of these, one per joint")]
pub enum PositionUnits {
    /// The same for every joint.
    All(PositionUnit),
    /// One per joint.
    Each(Vec<PositionUnit>),
}

/// The whole table.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Columns {
    /// Time; `t` unless given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time: Option<String>,
    /// Unit of `time`.
    #[serde(default, skip_serializing_if = "TimeUnit::is_default")]
    pub time_unit: TimeUnit,
    /// Positions, one column per joint; `q1`… unless given.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub position: Vec<String>,
    /// Unit of `position`, `link_position` and `reference`; rad (prismatic: m) unless given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_unit: Option<PositionUnits>,
    /// Column × unit × scale = joint position: a sign, or the gear of a motor's angle.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_scale: Option<PerJoint>,
    /// Torques, one column per joint; `tau1`… unless given.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub torque: Vec<String>,
    /// Column × scale = torque at the joint in the robot file's `torque_unit`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub torque_scale: Option<PerJoint>,
    /// Names of the joints in JointState messages, and behind `q_` and `tau_` in tables, where recordings name them
    /// otherwise than this file.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub joints: Vec<String>,
    /// Joint temperatures [°C], one column per joint.
    #[serde(default)]
    pub temperature: Vec<String>,
    /// 1 while the drive is on, 0 while it is off.
    pub enabled: Option<String>,
    /// Link-side encoder positions [`position_unit`], for the first joints.
    #[serde(default)]
    pub link_position: Vec<String>,
    /// Joint torque sensor [Nm].
    #[serde(default)]
    pub link_torque: Vec<String>,
    /// Commanded positions [`position_unit`], one column per joint: what the controller was told to follow.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub reference: Vec<String>,
}

impl Columns {
    /// How many rad (prismatic: m) one of joint `j`'s position unit is.
    pub fn unit_factor(&self, j: usize) -> f64 {
        match &self.position_unit {
            None => 1.0,
            Some(PositionUnits::All(unit)) => unit.factor(),
            Some(PositionUnits::Each(units)) => units.get(j).map_or(1.0, |unit| unit.factor()),
        }
    }

    /// Joint position per unit of the column of joint `j`.
    pub fn position_factor(&self, j: usize) -> f64 {
        self.unit_factor(j) * self.position_scale.as_ref().and_then(|s| s.get(j)).unwrap_or(1.0)
    }

    /// Joint torque per unit of the column of joint `j`.
    pub fn torque_factor(&self, j: usize) -> f64 {
        self.torque_scale.as_ref().and_then(|s| s.get(j)).unwrap_or(1.0)
    }

    /// Checks the table of a robot with `n` joints.
    ///
    /// # Errors
    /// [`BadInput`] naming the key, what was found and what was expected.
    pub fn validate(&self, n: usize) -> Result<(), BadInput> {
        for (key, list) in [
            ("temperature", &self.temperature),
            ("link_position", &self.link_position),
            ("link_torque", &self.link_torque),
            ("reference", &self.reference),
        ] {
            if list.len() > n {
                return Err(BadInput::new(format!(
                    "columns.{key}: found {} columns; expected at most {n}, one per joint",
                    list.len()
                )));
            }
        }
        for (key, list) in [("position", &self.position), ("torque", &self.torque), ("joints", &self.joints)] {
            if !(list.is_empty() || list.len() == n) {
                return Err(BadInput::new(format!(
                    "columns.{key}: found {} names; expected {n}, one per joint",
                    list.len()
                )));
            }
        }
        self.validate_scales(n)?;
        let named: Vec<&String> = self.time.iter().chain(&self.position).chain(&self.torque).collect();
        if let Some(i) = (0..named.len()).find(|&i| named.iter().take(i).any(|other| *other == named[i])) {
            return Err(BadInput::new(format!(
                "columns: found \"{}\" twice; expected a column each for time, positions and torques",
                named[i]
            )));
        }
        match self.joints.iter().enumerate().find(|(i, name)| self.joints.iter().take(*i).any(|other| other == *name)) {
            Some((_, twice)) => {
                Err(BadInput::new(format!("columns.joints: found \"{twice}\" twice; expected distinct names")))
            }
            None => Ok(()),
        }
    }

    /// Units and scales belong to columns that are named: what has the usual names has the usual units.
    fn validate_scales(&self, n: usize) -> Result<(), BadInput> {
        let lone = |key: &str, of: &str, usual: &str| {
            Err(BadInput::new(format!(
                "columns.{key}: found no columns.{of} beside it; expected the columns that it is about ({usual})"
            )))
        };
        if self.time_unit != TimeUnit::S && self.time.is_none() {
            return lone("time_unit", "time", "t alone is in seconds");
        }
        let others = !self.link_position.is_empty() || !self.reference.is_empty();
        if self.position_unit.is_some() && self.position.is_empty() && !others {
            return lone("position_unit", "position", "q1… alone are in rad");
        }
        if self.position_scale.is_some() && self.position.is_empty() {
            return lone("position_scale", "position", "q1… alone are joint positions");
        }
        if self.torque_scale.is_some() && self.torque.is_empty() {
            return lone("torque_scale", "torque", "tau1… alone are joint torques");
        }
        if let Some(PositionUnits::Each(units)) = &self.position_unit
            && units.len() != n
        {
            return Err(BadInput::new(format!(
                "columns.position_unit: found {} units; expected one, or one per joint ({n})",
                units.len()
            )));
        }
        for (key, scale) in [("position_scale", &self.position_scale), ("torque_scale", &self.torque_scale)] {
            let Some(scale) = scale else { continue };
            if let PerJoint::Each(list) = scale
                && list.len() != n
            {
                return Err(BadInput::new(format!(
                    "columns.{key}: found {} values; expected one, or one per joint ({n})",
                    list.len()
                )));
            }
            if let Some(v) = (0..n).filter_map(|j| scale.get(j)).find(|v| !v.is_finite() || *v == 0.0) {
                return Err(BadInput::new(format!("columns.{key}: found {v}; expected a finite, non-zero number")));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::RobotFile;

    fn parse(table: &str) -> Result<Columns, BadInput> {
        let text =
            format!("kind = \"serial\"\nname = \"r\"\njoints = [\"a\", \"b\"]\n[[dh]]\n[[dh]]\n[columns]\n{table}\n");
        RobotFile::parse(&text).map(|robot| robot.columns)
    }

    #[test]
    fn factors_are_unit_times_scale() {
        let c =
            parse("position = [\"x\", \"y\"]\nposition_unit = [\"deg\", \"mm\"]\nposition_scale = [-0.5, 2]").unwrap();
        assert!((c.position_factor(0) + 0.5 * PI / 180.0).abs() < 1e-18);
        assert!((c.position_factor(1) - 2e-3).abs() < 1e-18);
        assert_eq!((c.unit_factor(0), c.torque_factor(0)), (PI / 180.0, 1.0));
        let c = parse("position = [\"x\", \"y\"]\nposition_unit = \"turn\"").unwrap();
        assert_eq!([c.position_factor(0), c.position_factor(1)], [TAU, TAU]);
    }

    #[test]
    fn what_does_not_fit_is_said() {
        for (table, expect) in [
            ("time_unit = \"ms\"", "columns.time_unit: found no columns.time"),
            ("time = \"x\"\ntime_unit = \"h\"", "h"),
            ("position = [\"x\"]", "columns.position: found 1 names; expected 2"),
            ("position_unit = \"deg\"", "q1… alone are in rad"),
            ("position = [\"x\", \"y\"]\nposition_unit = \"degrees\"", "expected rad, deg, turn, m or mm"),
            ("position = [\"x\", \"y\"]\nposition_unit = [\"deg\"]", "found 1 units"),
            ("position_scale = 2", "columns.position_scale"),
            ("torque_scale = 2", "columns.torque_scale"),
            ("torque = [\"x\", \"y\"]\ntorque_scale = [1, 0]", "non-zero"),
            ("torque = [\"x\", \"y\"]\ntorque_scale = [1]", "found 1 values"),
            ("time = \"x\"\ntorque = [\"x\", \"y\"]", "\"x\" twice"),
            ("joints = [\"u\", \"u\"]", "\"u\" twice"),
            ("temperature = [\"u\", \"v\", \"w\"]", "at most 2"),
        ] {
            let e = parse(table).unwrap_err().to_string();
            assert!(e.contains(expect) && !e.contains('\n'), "{table}: {e}");
        }
    }
}
