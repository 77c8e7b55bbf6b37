//! What can go wrong with a proof itself, as opposed to what a diagnosis gets wrong: that is a result.

use lacuna_estimation::EstimationError;
use lacuna_interfaces::BadInput;
use std::path::Path;

/// Why a proof could not be made.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A file or an option that cannot be used.
    #[error(transparent)]
    Input(#[from] BadInput),
    /// The operating system refused, or an answer was not the one that was sealed.
    #[error("{0}")]
    Run(String),
}

impl From<EstimationError> for Error {
    fn from(e: EstimationError) -> Self {
        Self::Run(e.to_string())
    }
}

/// For `map_err`: what could not be done with `path`.
pub(crate) fn io<'a>(what: &'a str, path: &'a Path) -> impl FnOnce(std::io::Error) -> Error + 'a {
    move |e| Error::Run(format!("{}: cannot be {what}: {e}", path.display()))
}
