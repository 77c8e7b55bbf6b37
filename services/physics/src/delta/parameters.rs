//! The Delta's linear parameter vector π.
//!
//! | symbol | unit | nominal (M_KH) | multiplies |
//! |---|---|---|---|
//! | `I1`…`I3` | kg m² | (m1/3 + m2) l1² + J_r | θ̈_i |
//! | `gc1`…`gc3` | kg m | (m1/2 + m2) l1 | −g·∂e/∂θ (−9.81 cos θ if level) |
//! | `gs1`…`gs3` | kg m | 0 | g·e (9.81 sin θ if level) |
//! | `m_in` | kg | m0 + 3 m2 | Jᵀ ẍ |
//! | `m_gr` | kg | m0 + 3 m2 | −Jᵀ g |
//! | `m_JE` | kg | 0 | u·ẍ + Jᵀ Σ a_J |
//!
//! e is the unit vector along the upper arm; `gc` is the leg's first moment along it, `gs` across it.
//! `m_JE` couples elbow and platform when the forearm's mass is distributed; M_KH lumps it and has none.

use crate::Parameter;
use lacuna_interfaces::robot::Mass;

/// Number of parameters of a Delta.
pub const PARAMETERS: usize = 12;
/// Index of `I1`.
pub const INERTIA: usize = 0;
/// Index of `gc1`.
pub const GC: usize = 3;
/// Index of `gs1`.
pub const GS: usize = 6;
/// Index of `m_in`.
pub const M_IN: usize = 9;
/// Index of `m_gr`.
pub const M_GR: usize = 10;
/// Index of `m_JE`.
pub const M_JE: usize = 11;

/// A forearm (both rods of a leg together) with distributed mass.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Forearm {
    /// Mass m_f [kg].
    pub mass_kg: f64,
    /// Centre of mass as a fraction ξ of l2 from the elbow.
    pub com_fraction: f64,
    /// Inertia I_f across the rod about the centre of mass [kg m²].
    pub inertia_kg_m2: f64,
}

impl Forearm {
    /// Uniform slender rods of length `l2_m`.
    pub fn uniform(mass_kg: f64, l2_m: f64) -> Self {
        Self { mass_kg, com_fraction: 0.5, inertia_kg_m2: mass_kg * l2_m * l2_m / 12.0 }
    }
}

/// M_Id from M_KH: ρ1 scales the inertias, ρ2 the gravity moments of the legs (paper eq. 6).
#[must_use]
pub fn grey_box(pi: &[f64; PARAMETERS], rho1: f64, rho2: f64) -> [f64; PARAMETERS] {
    let mut out = *pi;
    out[INERTIA..INERTIA + 3].iter_mut().for_each(|v| *v *= rho1);
    out[GC..GS + 3].iter_mut().for_each(|v| *v *= rho2);
    out
}

/// π of forearms with distributed mass (NOTATION.md, "Distributed forearm").
pub(super) fn distributed(l1: f64, l2: f64, m: &Mass, f: &Forearm) -> [f64; PARAMETERS] {
    let (m_f, xi, turning) = (f.mass_kg, f.com_fraction, f.inertia_kg_m2 / (l2 * l2));
    let m_jj = m_f * (1.0 - xi).powi(2) + turning;
    let m_je = m_f * xi * (1.0 - xi) - turning;
    let m_ee = m_f * xi.powi(2) + turning;
    let mut pi = [0.0; PARAMETERS];
    pi[INERTIA..INERTIA + 3].fill((m.upper_arm / 3.0 + m_jj) * l1 * l1 + m.rotor_inertia);
    pi[GC..GC + 3].fill((m.upper_arm / 2.0 + m_f * (1.0 - xi)) * l1);
    pi[M_IN] = m.platform + 3.0 * m_ee;
    pi[M_GR] = m.platform + 3.0 * m_f * xi;
    pi[M_JE] = m_je;
    pi
}

/// The parameters with the nominal values of M_KH.
pub(super) fn list(l1: f64, m: &Mass) -> Vec<Parameter> {
    let inertia = (m.upper_arm / 3.0 + m.forearm_point) * l1 * l1 + m.rotor_inertia;
    let moment = (m.upper_arm / 2.0 + m.forearm_point) * l1;
    let platform = m.platform + 3.0 * m.forearm_point;
    let mut out = Vec::with_capacity(PARAMETERS);
    for (symbol, unit, nominal, meaning) in [
        ("I", "kg m^2", inertia, "inertia of upper arm, elbow mass, rotor and gear about the axis"),
        ("gc", "kg m", moment, "first moment of the leg along the upper arm (cosine of gravity)"),
        ("gs", "kg m", 0.0, "first moment of the leg across the upper arm (sine of gravity)"),
    ] {
        for i in 0..3 {
            out.push(Parameter {
                symbol: format!("{symbol}{}", i + 1),
                unit,
                nominal,
                joint: Some(i),
                meaning: format!("leg {}: {meaning}", i + 1),
            });
        }
    }
    for (symbol, nominal, meaning) in [
        ("m_in", platform, "inertial mass of the platform with the forearms' share"),
        ("m_gr", platform, "weighing mass of the platform with the forearms' share"),
        ("m_JE", 0.0, "coupling of elbow and platform acceleration by forearms of distributed mass"),
    ] {
        out.push(Parameter {
            symbol: symbol.to_owned(),
            unit: "kg",
            nominal,
            joint: None,
            meaning: meaning.to_owned(),
        });
    }
    out
}
