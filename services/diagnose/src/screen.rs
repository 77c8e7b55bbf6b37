//! Where to look for backlash and elasticity: the score over gap, stiffness and damping has wells a few per cent
//! wide, so a dense grid is run with a scalar link (its own inertia, the model's link torque, no feedback of the
//! deflection) on the recordings with the largest residual. The best places are then judged and refined with
//! the catalogue's own simulation.

use crate::families::Context;
use crate::scene::Column;
use crate::search::Search;
use lacuna_physics::Motion;
use rayon::prelude::*;
use std::ops::Range;

/// Sub-steps a sample.
const SUBSTEPS: usize = 6;
/// Stretches that are looked at.
const STRETCHES: usize = 2;
/// Length of a stretch [s].
const STRETCH_S: f64 = 5.0;

/// Link of one joint along a stretch of a piece.
struct Link {
    /// Rows of the stretch.
    rows: Range<usize>,
    torque: Vec<f64>,
    inertia: Vec<f64>,
}

/// Gap, stiffness, damping ratio.
pub type Shape = [f64; 3];

impl Search<'_> {
    /// The most promising shapes `[b, k, zeta]` of backlash at joint `j`, best first, well apart.
    pub fn screen_backlash(&self, ctx: &Context<'_>, residual: &Column, j: usize) -> Vec<Vec<f64>> {
        let band = self.scene.band_hz;
        let mut shapes: Vec<Shape> = Vec::new();
        for b in steps(2e-4, 8e-3, 1.04) {
            for hz in steps(0.6 * band, 2.6 * band, 1.15) {
                for zeta in [0.03, 0.1, 0.25] {
                    shapes.push([b, ctx.inertia[j] * (std::f64::consts::TAU * hz).powi(2), zeta]);
                }
            }
        }
        self.screened(ctx, residual, j, shapes).into_iter().map(|s| s.to_vec()).collect()
    }

    /// The most promising shapes `[k, zeta]` of an elastic joint `j`, best first, well apart.
    pub fn screen_elasticity(&self, ctx: &Context<'_>, residual: &Column, j: usize) -> Vec<Vec<f64>> {
        let band = self.scene.band_hz;
        let mut shapes: Vec<Shape> = Vec::new();
        for hz in steps(0.15 * band, 1.8 * band, 1.03) {
            for zeta in [0.02, 0.06, 0.15] {
                shapes.push([0.0, ctx.inertia[j] * (std::f64::consts::TAU * hz).powi(2), zeta]);
            }
        }
        self.screened(ctx, residual, j, shapes).into_iter().map(|s| s[1..].to_vec()).collect()
    }

    /// The best of `shapes`, well apart.
    fn screened(&self, ctx: &Context<'_>, residual: &Column, j: usize, shapes: Vec<Shape>) -> Vec<Shape> {
        let links = self.links(ctx, residual, j);
        let mut scored: Vec<(f64, Shape)> =
            shapes.into_par_iter().map(|s| (self.likeness(&links, residual, j, &s), s)).collect();
        scored.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut out: Vec<Shape> = Vec::new();
        for (_, s) in scored.into_iter().filter(|s| s.0 > 0.05).take(60) {
            let near = |o: &Shape| {
                (o[0] == s[0] || (o[0] / s[0]).ln().abs() < 0.06) && (o[1] / s[1]).ln().abs() < 0.2 && o[2] == s[2]
            };
            if out.len() < 5 && !out.iter().any(near) {
                out.push(s);
            }
        }
        out
    }

    fn links(&self, ctx: &Context<'_>, residual: &Column, j: usize) -> Vec<Link> {
        let scene = self.scene;
        let length = ((STRETCH_S * scene.row_rate_hz()) as usize).max(1);
        // The stretch with the largest residual of each piece, and of these the largest.
        let energy = |rows: &Range<usize>| residual.part[j][rows.clone()].iter().map(|v| v * v).sum::<f64>();
        let largest = |rows: Range<usize>| {
            let starts = rows.clone().step_by(length).map(|a| a.min(rows.end.saturating_sub(length)).max(rows.start));
            let stretches = starts.map(|a| a..(a + length).min(rows.end)).map(|s| (energy(&s), s));
            stretches.max_by(|a, b| a.0.total_cmp(&b.0))
        };
        let pieces = scene.pieces.iter().enumerate();
        let mut all: Vec<_> = pieces.filter_map(|(p, piece)| Some((p, largest(piece.rows.clone())?))).collect();
        all.sort_by(|a, b| b.1.0.total_cmp(&a.1.0));
        let link = |(p, (_, rows)): (usize, (f64, Range<usize>))| {
            let start = (rows.start - scene.pieces[p].rows.start) * scene.stride;
            let samples = start..(start + rows.len() * scene.stride).min(scene.pieces[p].len());
            let torque = ctx.link[p][j][samples.clone()].to_vec();
            Link { rows, torque, inertia: self.own_inertia(ctx, p, samples, j) }
        };
        all.into_iter().take(STRETCHES).map(link).collect()
    }

    /// Link-side inertia of joint `j` along samples of a piece.
    fn own_inertia(&self, ctx: &Context<'_>, p: usize, samples: Range<usize>, j: usize) -> Vec<f64> {
        let scene = self.scene;
        let n = scene.joints;
        let piece = &scene.pieces[p];
        let zero = vec![0.0; n];
        let mut unit = zero.clone();
        unit[j] = 1.0;
        let body = scene.body.with_gravity([0.0; 3]);
        let rotor = ctx.rotor[j];
        let (mut q, mut tau) = (zero.clone(), zero.clone());
        samples
            .map(|k| {
                for i in 0..n {
                    q[i] = piece.q[i][k];
                }
                let motion = Motion { q_rad: &q, qd_rad_s: &zero, qdd_rad_s2: &unit };
                match body.torque(&motion, &scene.pi, &mut tau) {
                    Ok(()) if tau[j] - rotor > 0.1 * ctx.inertia[j] => tau[j] - rotor,
                    _ => ctx.inertia[j],
                }
            })
            .collect()
    }

    /// Squared correlation of the residual with what a gap would leave at joint `j`.
    fn likeness(&self, links: &[Link], residual: &Column, j: usize, shape: &Shape) -> f64 {
        let (mut rc, mut rr, mut cc) = (0.0, 0.0, 0.0);
        for link in links {
            let mut signal = swing(link, shape, 1.0 / self.scene.rate_hz);
            if !self.scene.smooth(&mut signal) {
                return 0.0;
            }
            for (i, row) in link.rows.clone().enumerate() {
                if self.scene.mask[j][row] {
                    let (r, c) = (residual.part[j][row], signal[i * self.scene.stride]);
                    rc += r * c;
                    rr += r * r;
                    cc += c * c;
                }
            }
        }
        if rc > 0.0 { rc * rc / (rr * cc).max(1e-30) } else { 0.0 }
    }
}

/// −M ë of a link behind a gap, driven by its torque.
fn swing(link: &Link, shape: &Shape, dt: f64) -> Vec<f64> {
    let [b, k, zeta] = *shape;
    let h = dt / SUBSTEPS as f64;
    let first = link.torque.first().copied().unwrap_or(0.0);
    let (mut e, mut v) = (b * first.signum() + first / k, 0.0);
    link.torque
        .iter()
        .zip(&link.inertia)
        .map(|(f, m)| {
            let d = 2.0 * zeta * (k * m).sqrt();
            let before = v;
            for _ in 0..SUBSTEPS {
                let depth = if e > b {
                    e - b
                } else if e < -b {
                    e + b
                } else {
                    0.0
                };
                let contact = if depth == 0.0 { 0.0 } else { k * depth + d * v };
                v += h * (f - contact) / m;
                e += h * v;
            }
            -m * (v - before) / dt
        })
        .collect()
}

fn steps(low: f64, high: f64, ratio: f64) -> Vec<f64> {
    let n = ((high / low).ln() / ratio.ln()).floor() as i32;
    (0..=n).map(|i| low * ratio.powi(i)).collect()
}
