//! Where effects beyond viscous and Coulomb friction enter the stream.

use lacuna_interfaces::{BadInput, Joints, ModelFile, RobotFile, TorqueModel};

/// A term of the model file at work on the stream: a law with its parameters, and its memory if it has one.
pub trait TermState: Send {
    /// Adds the term's torque at this sample [Nm] to `torque_nm`. A term with memory steps it, over the time
    /// since the sample before (`header.stamp_ns`), and starts anew at `flag::STATE_RESET`. Never allocates.
    fn add(&mut self, sample: &TorqueModel, torque_nm: &mut Joints);
}

/// The terms of a model file, ready to run.
///
/// # Errors
/// [`BadInput`] for an effect that the friction stage does not know.
pub fn build_terms(model: &ModelFile, robot: &RobotFile) -> Result<Vec<Box<dyn TermState>>, BadInput> {
    let _ = robot;
    match model.terms.first() {
        None => Ok(Vec::new()),
        Some(term) => Err(BadInput::new(format!(
            "term[0]: effect \"{}\" is not one the friction stage can run; expected viscous and Coulomb friction \
             under [friction], and no [[term]]",
            term.effect
        ))),
    }
}
