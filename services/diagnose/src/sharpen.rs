//! The search once more on whitened residuals, where what the plain one leaves is slow.
//!
//! Gross effects are found first, on residuals as they are: an autoregression fitted to a large misfit would whiten it
//! away. What is left on a real robot is coloured by a hundred small causes; on it only whitened evidence tells a sharp
//! law from a slow one. What it finds must hold in the torque's own unit as well: fitted plainly, it must take
//! something off the error on the folds left out.

use crate::base::Base;
use crate::model::Atom;
use crate::search::{Search, State};
use crate::select::Selection;
use crate::whiten::Whitening;

/// Share of independent rows below which a joint's residual is coloured: noise in the band has two to three times it.
const COLOURED: f64 = 0.15;

/// `selection`, or what the search on whitened residuals makes of it.
pub(crate) fn sharpened(
    plain: &Search<'_>,
    base: &Base,
    selection: Selection,
    progress: &mut dyn FnMut(f64, &str),
) -> Option<Selection> {
    let coloured: Vec<bool> = selection.state.independent.iter().map(|share| *share < COLOURED).collect();
    if !coloured.contains(&true) {
        return Some(selection);
    }
    progress(0.78, "searching what is left, whitened");
    let residual = plain.residual(&selection.model, &selection.state);
    let whitening = Whitening::of(plain.scene, &residual, &coloured);
    let search = Search::new(plain.scene, plain.families, plain.target.clone(), plain.limits.clone())
        .with_base_rms(plain.base_rms_nm.get().cloned())
        .whitened(whitening);
    let Some(mut sharp) = search.select_from(base, selection.model.clone(), &[], progress) else {
        return Some(selection);
    };
    sharp.fallen = selection.fallen.clone();
    // What was tried and left is told, and calibrated, on residuals as they are.
    sharp.excluded = selection.excluded.clone();
    hold(plain, &mut sharp, progress)?;
    let error =
        |state: &State| (0..plain.scene.joints).map(|j| state.fit.held_out_joint(j).max(1e-30).ln()).sum::<f64>();
    let better = error(&sharp.state) < error(&selection.state);
    progress(
        0.79,
        &format!("whitened: {} {}", if better { "taken" } else { "left" }, changes(plain, &selection, &sharp)),
    );
    Some(if better { sharp } else { selection })
}

/// What came and what went, in words.
fn changes(plain: &Search<'_>, old: &Selection, new: &Selection) -> String {
    let words = |sign: &str, a: &Atom| format!("{sign}{}[{}]", plain.effect_of(a), a.joint + 1);
    let has = |s: &Selection, a: &Atom| s.model.atoms.iter().any(|b| (b.family, b.joint) == (a.family, a.joint));
    let came = new.model.atoms.iter().filter(|a| !has(old, a)).map(|a| words("+", a));
    let went = old.model.atoms.iter().filter(|a| !has(new, a)).map(|a| words("-", a));
    came.chain(went).collect::<Vec<_>>().join(" ")
}

/// Fits plainly, and takes out what then adds to the error on the folds left out.
fn hold(plain: &Search<'_>, sharp: &mut Selection, progress: &mut dyn FnMut(f64, &str)) -> Option<()> {
    loop {
        sharp.state = plain.fit(&mut sharp.model)?;
        let mut worst: Option<(usize, f64)> = None;
        for i in 0..sharp.model.atoms.len() {
            let without = plain.fit_without(&sharp.model, &sharp.state, &[i])?;
            let gain = plain.compare(&sharp.state, &without, &sharp.state.fit, Vec::new()).gain;
            if gain < 0.0 && worst.is_none_or(|(_, w)| gain < w) {
                worst = Some((i, gain));
            }
        }
        let Some((i, _)) = worst else { return Some(()) };
        let gone = sharp.model.atoms.remove(i);
        progress(0.79, &format!("- {} joint {}: not in the plain error", plain.effect_of(&gone), gone.joint + 1));
    }
}
