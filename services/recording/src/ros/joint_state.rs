//! `sensor_msgs/JointState` messages of any robot: decoded in place, joints found by name.

use super::cdr::{Cursor, Numbers};
use lacuna_interfaces::{BadInput, JointMeasured, MAX_JOINTS, RobotFile};

/// A decoded JointState, still in its bytes.
pub(crate) struct JointState<'a> {
    /// Header stamp.
    pub(crate) stamp_ns: i64,
    names: &'a [u8],
    cursor: Cursor<'a>,
    pub(crate) position: Numbers<'a>,
    pub(crate) effort: Numbers<'a>,
}

impl<'a> JointState<'a> {
    /// Decodes a message; `None` if it is no JointState.
    pub(crate) fn parse(message: &'a [u8]) -> Option<Self> {
        let mut cursor = Cursor::new(message)?;
        let stamp_ns = cursor.header()?;
        let names = cursor.strings()?;
        let position = cursor.numbers()?;
        let _velocity = cursor.numbers()?;
        let effort = cursor.numbers()?;
        Some(Self { stamp_ns, names, cursor, position, effort })
    }

    /// Names of its joints.
    pub(crate) fn joints(&self) -> Vec<String> {
        self.cursor.strings_of(self.names)
    }
}

/// What joints may be called in messages.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Names {
    /// As the robot file names them.
    pub(crate) own: Vec<String>,
    /// As recordings of others do (`columns.joints`); empty or one per joint.
    others: Vec<String>,
}

impl Names {
    /// Those of a robot.
    pub(crate) fn of(robot: &RobotFile) -> Self {
        Self { own: robot.joints.clone(), others: robot.columns.joints.clone() }
    }

    /// Where a list names joint `j`; the robot file's own name goes first.
    fn find(&self, j: usize, list: &[String]) -> Option<usize> {
        [&self.own, &self.others].iter().find_map(|names| {
            let name = names.get(j)?;
            list.iter().position(|n| n == name)
        })
    }

    /// What is expected, for messages.
    pub(crate) fn expected(&self) -> &[String] {
        if self.others.is_empty() { &self.own } else { &self.others }
    }
}

/// Where each joint stands in a message's name list, looked up once per distinct list.
#[derive(Debug, Default)]
pub(crate) struct Order {
    /// The list's bytes.
    of: Vec<u8>,
    /// Index of each joint in it; `None` if it is not there.
    pub(crate) at: [Option<usize>; MAX_JOINTS],
}

impl Order {
    /// Adjusts to the list of a message; the names if it is a new one.
    pub(crate) fn follow(&mut self, cursor: &Cursor<'_>, list: &[u8], joints: &Names) -> Option<Vec<String>> {
        if self.of == list {
            return None;
        }
        self.of.clear();
        self.of.extend_from_slice(list);
        let names = cursor.strings_of(list);
        self.at = [None; MAX_JOINTS];
        for (j, slot) in self.at.iter_mut().enumerate().take(joints.own.len()) {
            *slot = joints.find(j, &names);
        }
        Some(names)
    }
}

/// Finds the robot's joints in JointState messages.
#[derive(Debug)]
pub(crate) struct Matching {
    pub(crate) joints: Names,
    order: Order,
    /// Names in messages that were passed over.
    pub(crate) passed: Vec<String>,
}

impl Matching {
    /// Looks for these joints.
    pub(crate) fn new(joints: Names) -> Self {
        Self { joints, order: Order::default(), passed: Vec::new() }
    }

    /// Takes positions and torques out of a message; `false` if it is of none of the robot's joints.
    pub(crate) fn take(&mut self, state: &JointState<'_>, out: &mut JointMeasured) -> Result<bool, BadInput> {
        if let Some(names) = self.order.follow(&state.cursor, state.names, &self.joints) {
            self.check(names)?;
        }
        for (j, at) in self.order.at.iter().enumerate().take(self.joints.own.len()) {
            let Some(at) = *at else { return Ok(false) };
            let missing = |what: &str, list: &Numbers<'_>| {
                BadInput::new(format!(
                    "found {} {what} values; expected one for joint {}, which is number {}",
                    list.len(),
                    self.joints.own[j],
                    at + 1
                ))
            };
            out.q_rad[j] = state.position.get(at).ok_or_else(|| missing("position", &state.position))?;
            out.tau_nm[j] = state.effort.get(at).ok_or_else(|| missing("effort", &state.effort))?;
        }
        Ok(true)
    }

    /// Refuses a list that names a joint twice, or only some of them; remembers one that names none.
    fn check(&mut self, names: Vec<String>) -> Result<(), BadInput> {
        let both = self.joints.own.iter().chain(&self.joints.others);
        if let Some(twice) = both.into_iter().find(|j| names.iter().filter(|n| n == j).count() > 1) {
            return Err(BadInput::new(format!("found joint {twice} twice; expected distinct names")));
        }
        let absent = (0..self.joints.own.len()).filter(|&j| self.joints.find(j, &names).is_none());
        let missing: Vec<&str> = absent.filter_map(|j| self.joints.expected().get(j).map(String::as_str)).collect();
        if missing.len() == self.joints.own.len() {
            for name in names.into_iter().take(16) {
                if self.passed.len() < 64 && !self.passed.contains(&name) {
                    self.passed.push(name);
                }
            }
        } else if !missing.is_empty() {
            return Err(BadInput::new(format!(
                "found joints {}; expected also {}",
                names.join(", "),
                missing.join(", ")
            )));
        }
        Ok(())
    }
}
