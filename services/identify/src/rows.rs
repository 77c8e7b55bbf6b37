//! Filtered regressor rows of all recordings in memory: a reference for what is identified, from `crate::sums` instead.

use crate::base::Structure;
use crate::condition::{Plan, prepare};
use crate::layout::Chosen;
use crate::stream::{Class, PartRows, Stream};
use lacuna_interfaces::{BadInput, Recording, RobotFile};
use lacuna_physics::RigidBody;

/// Rows of one joint.
#[derive(Debug, Clone, Default)]
pub struct JointRows {
    /// Regressor, row-major: one entry per active base column of the joint ([`crate::base::Structure::active`]).
    pub x: Vec<f64>,
    /// Torque [Nm or the robot file's unit].
    pub y: Vec<f64>,
    /// Velocity [rad/s].
    pub qd: Vec<f64>,
    /// Drive on, moving or not.
    pub usable: Vec<bool>,
    /// Counts in an evaluation.
    pub counted: Vec<bool>,
    /// Used by the fit.
    pub fitted: Vec<bool>,
}

/// Rows of all joints at common instants.
#[derive(Debug, Clone, Default)]
pub struct Rows {
    /// Per joint.
    pub joints: Vec<JointRows>,
    /// Time of every row [s], in its recording's own time.
    pub time_s: Vec<f64>,
    /// Recording of every row.
    pub recording: Vec<usize>,
}

impl JointRows {
    /// Column `slot` of `width` active ones.
    pub fn column(&self, slot: usize, width: usize) -> impl Iterator<Item = f64> + '_ {
        self.x.iter().skip(slot).step_by(width.max(1)).copied()
    }
}

impl Rows {
    /// Number of instants.
    pub fn len(&self) -> usize {
        self.time_s.len()
    }

    /// True without rows.
    pub fn is_empty(&self) -> bool {
        self.time_s.is_empty()
    }
}

/// All rows of recordings, every stretch filtered in one piece; Coulomb friction by the sign of the velocity.
///
/// # Errors
/// [`BadInput`] naming the recording, where it cannot be conditioned or the robot cannot take a pose.
pub fn rows(
    body: &dyn RigidBody,
    robot: &RobotFile,
    structure: &Structure,
    plan: &Plan,
    recordings: &[Recording],
) -> Result<Rows, BadInput> {
    let mut own = recordings.to_vec();
    let prepared = own.iter_mut().map(|r| prepare(r, robot, plan)).collect::<Result<Vec<_>, _>>()?;
    let stream = Stream::in_parts(body, robot, structure, plan, &own, &prepared, usize::MAX);
    gather(&stream)
}

fn gather(stream: &Stream<'_>) -> Result<Rows, BadInput> {
    let mut out = Rows { joints: vec![JointRows::default(); stream.layout.len()], ..Rows::default() };
    stream.pass(
        |_, part| stream.rows_of(part, None),
        |rows| {
            append(stream, &mut out, &rows);
            Ok(())
        },
    )?;
    Ok(out)
}

fn append(stream: &Stream<'_>, out: &mut Rows, rows: &PartRows) {
    let (part, chosen) = (&rows.part, Chosen::plain());
    for ((to, from), layout) in out.joints.iter_mut().zip(&rows.joints).zip(&stream.layout) {
        let y = chosen.y(layout);
        for (k, z) in from.z.chunks_exact(layout.len()).enumerate() {
            to.x.extend((0..layout.width()).map(|slot| z[layout.place(slot, chosen.bristle)]));
            to.y.push(y.iter().map(|&(i, f)| f * z[i]).sum());
            to.qd.push(from.qd[k]);
            to.usable.push(from.class[k] >= Class::Standing);
            to.counted.push(from.class[k] >= Class::Counted);
            to.fitted.push(from.class[k] == Class::Fitted);
        }
    }
    for row in part.rows.clone() {
        out.time_s.push(stream.time_s(part.recording, part.stretch, row));
        out.recording.push(part.recording);
    }
}
