//! Table 1 of the paper: its three models, and the pooled fit beside them, on held-out rows.

use crate::evaluate::{Tally, Which};
use crate::fit::draft::{Data, chosen};
use crate::fit::predict;
use crate::hold_out::Fitted;
use crate::paper::ErrorTable;
use crate::rows::gather;
use crate::split::Fold;
use lacuna_interfaces::BadInput;

/// Models of the table.
const MODELS: [&str; 4] = ["M_KH", "M_Id", "M_Id+F", "pooled"];

/// Sums over the test rows of all folds.
#[derive(Default)]
pub(crate) struct PaperTables {
    all: [Tally; 4],
    moving: [Tally; 4],
}

impl PaperTables {
    /// Adds one fold's test rows.
    pub(crate) fn add(&mut self, data: Data<'_>, fold: &Fold, fitted: &Fitted) -> Result<(), BadInput> {
        let Some((p, _)) = &fitted.paper else { return Ok(()) };
        let stream = data.stream;
        let shift = fitted.shift_s;
        // The paper's models have the sign of the velocity, as the stages that run them do.
        let by_sign = gather(stream, |r, _| chosen(stream, r, None, shift))?;
        let own = gather(stream, |r, j| chosen(stream, r, fitted.bristle[j], shift))?;
        let test = by_sign.select(&fold.test);
        let models = [&p.nominal, &p.identified, &p.with_friction, &fitted.solution.beta];
        for (i, beta) in models.into_iter().enumerate() {
            let rows = if i < 3 { &by_sign } else { &own };
            for j in 0..rows.joints.len() {
                let predicted = predict(stream.structure, rows, beta, j);
                self.all[i].add(rows, j, &predicted, &test, Which::Usable, 1.0);
                self.moving[i].add(rows, j, &predicted, &test, Which::Counted, 1.0);
            }
        }
        Ok(())
    }

    /// μ and σ per joint of every model, over all and over moving rows.
    pub(crate) fn tables(&self) -> (Vec<ErrorTable>, Vec<ErrorTable>) {
        (tables(&self.all), tables(&self.moving))
    }
}

fn tables(tallies: &[Tally]) -> Vec<ErrorTable> {
    MODELS
        .iter()
        .zip(tallies)
        .filter_map(|(model, tally)| {
            let score = tally.score()?;
            Some(ErrorTable { model: (*model).to_owned(), mean_nm: score.mean_nm, std_nm: score.std_nm })
        })
        .collect()
}
