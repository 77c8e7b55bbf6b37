//! Table 1 of the paper: its three models, and the pooled fit beside them, on held-out rows.

use crate::evaluate::{Tally, Which};
use crate::fit::draft::{Data, chosen};
use crate::hold_out::{Fitted, residuals};
use crate::paper::ErrorTable;

/// Models of the table.
const MODELS: [&str; 4] = ["M_KH", "M_Id", "M_Id+F", "pooled"];

/// Sums over the test rows of all folds.
#[derive(Default)]
pub(crate) struct PaperTables {
    all: [Tally; 4],
    moving: [Tally; 4],
}

impl PaperTables {
    /// Adds one fold's test cells.
    pub(crate) fn add(&mut self, data: Data<'_>, test: &[bool], fitted: &Fitted) {
        let Some((p, _)) = &fitted.paper else { return };
        let models = [&p.nominal, &p.identified, &p.with_friction, &fitted.solution.beta];
        for j in 0..data.stream.layout.len() {
            for (i, beta) in models.iter().enumerate() {
                // The paper's models have the sign of the velocity, as the stages that run them do.
                let bristle = if i < 3 { None } else { fitted.bristle[j] };
                let columns = |r: usize| chosen(data.stream, r, bristle, fitted.shift_s);
                let of = |which: Which| residuals(data, test, &columns, j, beta, which);
                self.all[i].add_sums(j, of(Which::Usable), 1.0);
                self.moving[i].add_sums(j, of(Which::Counted), 1.0);
            }
        }
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
