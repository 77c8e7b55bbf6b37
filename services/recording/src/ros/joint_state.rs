//! `sensor_msgs/JointState` messages of any robot: decoded in place, joints found by name.

use super::cdr::{Cursor, Numbers};
use lacuna_interfaces::{BadInput, JointMeasured, MAX_JOINTS};

/// A decoded JointState, still in its bytes.
pub(crate) struct JointState<'a> {
    /// Header stamp.
    pub(crate) stamp_ns: i64,
    names: &'a [u8],
    cursor: Cursor<'a>,
    position: Numbers<'a>,
    effort: Numbers<'a>,
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
    pub(crate) fn follow(&mut self, cursor: &Cursor<'_>, list: &[u8], joints: &[String]) -> Option<Vec<String>> {
        if self.of == list {
            return None;
        }
        self.of.clear();
        self.of.extend_from_slice(list);
        let names = cursor.strings_of(list);
        self.at = [None; MAX_JOINTS];
        for (slot, joint) in self.at.iter_mut().zip(joints) {
            *slot = names.iter().position(|n| n == joint);
        }
        Some(names)
    }
}

/// Finds the robot's joints in JointState messages.
#[derive(Debug)]
pub(crate) struct Matching {
    pub(crate) joints: Vec<String>,
    order: Order,
    /// Names in messages that were passed over.
    pub(crate) passed: Vec<String>,
}

impl Matching {
    /// Looks for these joints.
    pub(crate) fn new(joints: Vec<String>) -> Self {
        Self { joints, order: Order::default(), passed: Vec::new() }
    }

    /// Takes positions and torques out of a message; `false` if it is of none of the robot's joints.
    pub(crate) fn take(&mut self, state: &JointState<'_>, out: &mut JointMeasured) -> Result<bool, BadInput> {
        if let Some(names) = self.order.follow(&state.cursor, state.names, &self.joints) {
            self.check(names)?;
        }
        for (j, at) in self.order.at.iter().enumerate().take(self.joints.len()) {
            let Some(at) = *at else { return Ok(false) };
            let missing = |what: &str, list: &Numbers<'_>| {
                BadInput::new(format!(
                    "found {} {what} values; expected one for joint {}, which is number {}",
                    list.len(),
                    self.joints[j],
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
        if let Some(twice) = self.joints.iter().find(|j| names.iter().filter(|n| n == j).count() > 1) {
            return Err(BadInput::new(format!("found joint {twice} twice; expected distinct names")));
        }
        let missing: Vec<&str> = self.joints.iter().filter(|j| !names.contains(j)).map(String::as_str).collect();
        if missing.len() == self.joints.len() {
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
