//! From evidence to probabilities.

use crate::findings::Alternative;
use crate::report::Material;

/// Probability of an effect (or its group) and of its rivals, from their merits.
pub fn probability(m: &Material<'_>, id: &str, nats: f64, group: &[String]) -> (f64, Vec<Alternative>) {
    // One nat of held-out evidence is worth less than one of a perfect model: calibrated on simulated robots.
    const SCALE: f64 = 10.0;
    let there = 1.0 / (1.0 + (-(nats - 20.0) / SCALE).exp());
    let Some(rivals) = m.selection.rivals.iter().find(|r| r.effect == id) else {
        return (there, Vec::new());
    };
    let weight = |merit: f64| ((merit - rivals.merit) / SCALE).min(0.0).exp();
    let others: Vec<(&str, f64)> = rivals
        .others
        .iter()
        .filter(|(o, merit)| *merit > 0.0 && !group.iter().any(|g| g == o))
        .map(|(o, merit)| (*o, weight(*merit)))
        .collect();
    let total = 1.0 + others.iter().map(|o| o.1).sum::<f64>();
    let alternatives = others
        .iter()
        .map(|(o, w)| Alternative { effect: (*o).to_owned(), probability: there * w / total })
        .filter(|a| a.probability > 1e-3)
        .collect();
    (there / total, alternatives)
}
