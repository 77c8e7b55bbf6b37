//! What an effect is at work: torque per unit of each amplitude, sample by sample.

use lacuna_interfaces::{Joints, MAX_JOINTS};

/// Everything a law may depend on at one sample. Entries beyond the robot's joints are not read.
#[derive(Debug, Clone, Copy)]
pub struct EffectSample<'a> {
    /// Time on the recording's clock, for events and warming up [s].
    pub t_s: f64,
    /// Time since the sample before [s]; 0 at the first one after a reset.
    pub dt_s: f64,
    /// Joint positions θ [rad].
    pub q_rad: &'a Joints,
    /// Joint velocities θ̇ [rad/s].
    pub qd_rad_s: &'a Joints,
    /// Joint accelerations θ̈ [rad/s²].
    pub qdd_rad_s2: &'a Joints,
    /// sgn θ̇ in [−1, 1], with the caller's treatment of standstill.
    pub direction: &'a Joints,
    /// Speed over which the sign of a speed that is no joint's own (a motor's behind a coupling) goes from 0
    /// to 1 [rad/s].
    pub ramp_rad_s: f64,
    /// Torque that the gear passes to the link [Nm]: rigid body without rotor inertia, and link-side effects.
    pub tau_link_nm: &'a Joints,
    /// Torque that the drive is predicted to give [Nm]: rigid body, friction and all effects before the drive.
    pub tau_drive_nm: &'a Joints,
    /// Joint temperatures [°C]; NaN where there is none.
    pub temperature_degc: &'a Joints,
}

/// Where a kernel writes: columns of `n` joints each, all zero at first.
#[derive(Debug)]
pub struct ColumnSink<'a> {
    n: usize,
    values: &'a mut [f64],
}

impl<'a> ColumnSink<'a> {
    /// A sink over `values`, column after column of `n` joints. Sets them to zero.
    pub fn new(n: usize, values: &'a mut [f64]) -> Self {
        values.fill(0.0);
        Self { n: n.max(1), values }
    }

    /// Sets the torque at `joint` per unit of amplitude `column`.
    #[inline]
    pub fn set(&mut self, column: usize, joint: usize, torque_nm: f64) {
        if let Some(slot) = self.values.get_mut(column * self.n + joint) {
            *slot = torque_nm;
        }
    }

    /// Sets the torques of all joints per unit of amplitude `column`.
    #[inline]
    pub fn set_all(&mut self, column: usize, torque_nm: &Joints) {
        for (slot, v) in self.values.iter_mut().skip(column * self.n).take(self.n).zip(torque_nm) {
            *slot = *v;
        }
    }
}

/// An effect with its shape parameters fixed.
///
/// A kernel never allocates and never panics; where the robot's mechanics have no answer (a pose out of
/// reach) it leaves its columns at zero.
pub trait Kernel: Send {
    /// Forgets everything: the next sample is the first.
    fn reset(&mut self);

    /// Writes this sample's columns, one per amplitude (one in all for an effect without amplitudes), and
    /// steps the memory by `sample.dt_s` if there is one.
    fn columns(&mut self, sample: &EffectSample<'_>, sink: &mut ColumnSink<'_>);
}

/// A kernel without memory.
struct Stateless<F>(F);

impl<F: FnMut(&EffectSample<'_>, &mut ColumnSink<'_>) + Send> Kernel for Stateless<F> {
    fn reset(&mut self) {}

    fn columns(&mut self, sample: &EffectSample<'_>, sink: &mut ColumnSink<'_>) {
        (self.0)(sample, sink);
    }
}

/// The kernel of a law without memory over the whole robot.
pub(super) fn law(law: impl FnMut(&EffectSample<'_>, &mut ColumnSink<'_>) + Send + 'static) -> Box<dyn Kernel> {
    Box::new(Stateless(law))
}

/// The kernel of a law without memory that gives each joint its own torque: `P` amplitudes.
pub(super) fn joint_law<const P: usize>(
    joints: &[usize],
    f: impl Fn(&EffectSample<'_>, usize) -> [f64; P] + Send + 'static,
) -> Box<dyn Kernel> {
    let joints: Vec<usize> = joints.iter().copied().filter(|&j| j < MAX_JOINTS).collect();
    law(move |sample, sink| {
        for &j in &joints {
            for (c, torque) in f(sample, j).into_iter().enumerate() {
                sink.set(c, j, torque);
            }
        }
    })
}
