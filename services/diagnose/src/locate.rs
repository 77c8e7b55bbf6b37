//! Where the mismatch is: joints, regions of the motion, and sizes.

use crate::families::Context;
use crate::findings::{Finding, Where};
use crate::scene::Column;
use crate::search::Search;

/// Share of the mismatch below which a joint is not worth a word.
const WORTH: f64 = 0.05;

impl Search<'_> {
    /// Joints with their share of the mismatch, the region in which it is largest and the stage it belongs to.
    pub fn locate(&self, ctx: &Context<'_>, residual: &Column, excess: &[f64], findings: &[Finding]) -> Vec<Where> {
        let total: f64 = excess.iter().sum();
        let mut out: Vec<Where> = Vec::new();
        for (j, own) in excess.iter().enumerate() {
            let share = own / total.max(1e-30);
            if share < WORTH {
                continue;
            }
            let name = &self.scene.robot.joints[j];
            let region = self.map(ctx, residual, j).filter(|(share, _, _)| *share > 0.1).map(|(_, _, r)| r);
            let acts = |f: &&Finding| f.joints.is_empty() || f.joints.contains(name);
            let first = findings.iter().find(acts);
            let mask = &self.scene.mask[j];
            let count = mask.iter().filter(|m| **m).count().max(1) as f64;
            out.push(Where {
                joint: name.clone(),
                share,
                stage: first.map_or_else(|| "friction".to_owned(), |f| f.stage.clone()),
                region: region.into_iter().collect(),
                intervals_s: first.map(|f| f.intervals_s.clone()).unwrap_or_default(),
                rms_nm: (own / count).sqrt(),
            });
        }
        out.sort_by(|a, b| b.share.total_cmp(&a.share));
        out
    }
}
