//! Where an effect acts, by its own law, and what it is worth there.

use crate::findings::{Parameter, Reduction, Region};
use crate::held::Blocks;
use crate::proof::Proof;
use crate::scene::{Column, Scene};
use crate::unknown::since_reversal;

/// Region of an effect whose law has one.
pub fn of(effect: &str, parameters: &[Parameter]) -> Option<Region> {
    let largest = |symbol: &str| {
        parameters
            .iter()
            .filter(|p| p.symbol == symbol)
            .map(|p| p.value.abs())
            .fold(None, |m: Option<f64>, v| Some(m.map_or(v, |m| m.max(v))))
    };
    match effect {
        // Two thirds of the excess are gone at v_s, nine tenths at one and a half of it.
        "stribeck" => {
            let v = 1.5 * largest("v_s")?;
            Some(Region { variable: "qd_rad_s".into(), low: -v, high: v })
        }
        // What is missing of the full friction falls to a tenth over 2.3 δ.
        "presliding" => Some(Region { variable: "since_reversal_rad".into(), low: 0.0, high: 2.3 * largest("delta")? }),
        _ => None,
    }
}

/// Rows of joint `j` within `region`, of those that count.
fn inside(scene: &Scene, region: &Region, j: usize) -> Vec<bool> {
    let range = region.low..=region.high;
    let mut out = vec![false; scene.rows];
    for piece in &scene.pieces {
        let travel = match region.variable.as_str() {
            "since_reversal_rad" => since_reversal(&piece.q[j], &piece.qd[j]),
            _ => Vec::new(),
        };
        for (i, row) in piece.rows.clone().enumerate() {
            let k = i * scene.stride;
            let value = match region.variable.as_str() {
                "qd_rad_s" => piece.qd[j].get(k),
                "q_rad" => piece.q[j].get(k),
                "qdd_rad_s2" => piece.qdd[j].get(k),
                _ => travel.get(k),
            };
            out[row] = scene.mask[j][row] && value.is_some_and(|v| range.contains(v));
        }
    }
    out
}

/// Fewest rows that say something of a region.
const LEAST: usize = 100;

/// What an effect is worth in its region; `left` is what the model without it leaves.
pub fn reduction(proof: &Proof<'_>, region: &Region, left: &Column, joints: &[usize]) -> Option<Reduction> {
    let scene = proof.scene;
    let mut masks = vec![vec![false; scene.rows]; scene.joints];
    for j in joints {
        masks[*j] = inside(scene, region, *j);
    }
    if masks.iter().flatten().filter(|m| **m).count() < LEAST {
        return None;
    }
    let blocks = Blocks::of(scene, &masks, proof.seed);
    let only = |residual: &Column| {
        let mut out = residual.clone();
        for (part, mask) in out.rows_mut().iter_mut().zip(&masks) {
            part.iter_mut().zip(mask).filter(|(_, m)| !**m).for_each(|(v, _)| *v = 0.0);
        }
        blocks.squares(&out)
    };
    let (before, after) = (only(left), only(&proof.after));
    let (reduction, ci95) = blocks.reduction(&before, &after, joints);
    Some(Reduction {
        before_rms_nm: blocks.rms(&before, joints),
        after_rms_nm: blocks.rms(&after, joints),
        reduction,
        ci95,
    })
}
