//! `[ethercat]` of a robot file: where a capture of the fieldbus holds the drives' CiA 402 objects.
//!
//! Each joint has one `[[ethercat.axis]]`, in the order of `joints`. Its objects are found in one of three ways:
//!
//! ```toml
//! [ethercat]
//! cycle_s = 0.001                # optional; else that of the ENI file, else drive.sample_rate_hz
//! eni = "cell.xml"               # the master's configuration, beside this file
//! [[ethercat.axis]]
//! slave = "Drive 1 (EL7211)"     # a slave of the ENI file: its objects by their index
//! [[ethercat.axis]]
//! position = "Drive 2.Position actual value"       # variables of the ENI file's process image
//! torque = "Drive 2.Torque actual value"
//! [[ethercat.axis]]              # or without an ENI file:
//! position = 0x1000              # logical byte address (LRD, LRW)
//! torque = { station = 1003, offset = 0x1104 }     # station address and memory offset (FPRD, FPRW)
//! ```

use crate::BadInput;
use crate::robot::RobotFile;
use serde::{Deserialize, Serialize};

/// Where one object lies.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged, expecting = "expected a logical address, { station, offset } or the name of a variable")]
pub enum Place {
    /// Logical byte address.
    Logical(u32),
    /// Memory of one slave.
    Station {
        /// Configured station address.
        station: u16,
        /// Offset in the slave's memory.
        offset: u16,
    },
    /// Variable of the ENI file's input image.
    Variable(String),
}

/// One joint's drive.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Axis {
    /// Slave of the ENI file whose objects are meant where no place is given.
    pub slave: Option<String>,
    /// 0x6064, position actual value, 32 bit signed [counts].
    pub position: Option<Place>,
    /// 0x6077, torque actual value, 16 bit signed [‰ of the rated torque].
    pub torque: Option<Place>,
    /// 0x606C, velocity actual value, 32 bit signed [counts/s].
    pub velocity: Option<Place>,
    /// 0x6041, status word, 16 bit.
    pub status: Option<Place>,
    /// Counts per motor turn; 2^`drive.encoder_bits` unless given.
    pub counts_per_turn: Option<f64>,
    /// Joint angle at count 0 [rad].
    #[serde(default)]
    pub offset_rad: f64,
}

/// The whole table.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ethercat {
    /// ENI file, relative to the robot file.
    pub eni: Option<String>,
    /// Bus cycle [s].
    pub cycle_s: Option<f64>,
    /// One per joint.
    #[serde(default)]
    pub axis: Vec<Axis>,
}

impl Ethercat {
    /// Checks that the table fits its robot.
    ///
    /// # Errors
    /// [`BadInput`] naming the key, what was found and what was expected.
    pub fn validate(&self, robot: &RobotFile) -> Result<(), BadInput> {
        let bad = |what: String| Err(BadInput::new(what));
        let n = robot.joint_count();
        if let Some(cycle) = self.cycle_s
            && !(cycle.is_finite() && cycle > 0.0)
        {
            return bad(format!("ethercat.cycle_s: found {cycle}; expected a positive number"));
        }
        if self.axis.len() != n && !(self.axis.is_empty() && self.eni.is_some()) {
            return bad(format!("ethercat.axis: found {} tables; expected {n}, one per joint", self.axis.len()));
        }
        for (i, axis) in self.axis.iter().enumerate() {
            let key = format!("ethercat.axis[{i}]");
            if let Some(counts) = axis.counts_per_turn
                && !(counts.is_finite() && counts > 0.0)
            {
                return bad(format!("{key}.counts_per_turn: found {counts}; expected a positive number"));
            }
            if !axis.offset_rad.is_finite() {
                return bad(format!("{key}.offset_rad: found {}; expected a finite number", axis.offset_rad));
            }
            if axis.slave.is_none() && (axis.position.is_none() || axis.torque.is_none()) {
                return bad(format!(
                    "{key}: found no position or no torque; expected both, or a slave of the ENI file"
                ));
            }
            let named = [&axis.position, &axis.torque, &axis.velocity, &axis.status];
            let by_name = named.iter().any(|p| matches!(p, Some(Place::Variable(_))));
            if self.eni.is_none() && (axis.slave.is_some() || by_name) {
                return bad(format!("{key}: found a name; expected addresses, or ethercat.eni to look the name up in"));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn robot(table: &str) -> Result<RobotFile, BadInput> {
        RobotFile::parse(&format!(
            "kind = \"serial\"\nname = \"one\"\njoints = [\"a\"]\n[[dh]]\n[drive]\nencoder_bits = 20\n[ethercat]\n{table}"
        ))
    }

    #[test]
    fn three_ways_to_name_a_place() {
        let text = "eni = \"x.xml\"\n[[ethercat.axis]]\nposition = 0x1000\ntorque = { station = 1001, offset = 4352 }\n\
                    status = \"Drive.Status\"\n";
        let table = robot(text).unwrap().ethercat.unwrap();
        assert_eq!(table.axis[0].position, Some(Place::Logical(0x1000)));
        assert_eq!(table.axis[0].torque, Some(Place::Station { station: 1001, offset: 0x1100 }));
        assert_eq!(table.axis[0].status, Some(Place::Variable("Drive.Status".to_owned())));
    }

    #[test]
    fn what_does_not_fit_is_said() {
        for (text, expect) in [
            ("", "found 0 tables; expected 1"),
            ("[[ethercat.axis]]\nposition = 1\n", "no torque"),
            ("[[ethercat.axis]]\nslave = \"x\"\n", "ethercat.eni"),
            ("[[ethercat.axis]]\nposition = \"p\"\ntorque = 3\n", "ethercat.eni"),
            ("cycle_s = 0\n[[ethercat.axis]]\nposition = 1\ntorque = 3\n", "cycle_s"),
            ("[[ethercat.axis]]\nposition = 1\ntorque = 3\ncounts_per_turn = -1\n", "counts_per_turn"),
            ("[[ethercat.axis]]\nposition = 1\ntorque = 3\noffset_rad = inf\n", "offset_rad"),
            ("[[ethercat.axis]]\nposition = -1\ntorque = 3\n", "expected a logical address"),
        ] {
            let e = robot(text).unwrap_err().to_string();
            assert!(e.contains(expect) && !e.contains('\n'), "{text}: {e}");
        }
    }
}
