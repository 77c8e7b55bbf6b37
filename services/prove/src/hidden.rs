//! The answer to a case, whoever made it: the project's own simulator or another engine.

use lacuna_interfaces::BadInput;
use lacuna_simulate::Truth;
use serde::Deserialize;
use std::collections::BTreeMap;

/// What a case hides.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Hidden {
    /// Effects beyond the robot file and friction.
    pub effects: Vec<Effect>,
    /// True if the robot has no friction at all, so that friction found counts as a finding.
    pub frictionless: bool,
    /// Residual that the true model leaves, per joint, below 40 Hz [Nm].
    pub oracle_rms_nm: Vec<f64>,
    /// What was carried when: file, from, to [s], mass [kg].
    pub carried: Vec<(String, f64, f64, f64)>,
}

/// One hidden effect.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Effect {
    /// Id.
    pub id: String,
    /// True if no catalogue lists it: the right answer is "unknown".
    pub unknown: bool,
    /// Ids that are as good an answer.
    pub also_accept: Vec<String>,
    /// Joints; empty if it acts on the whole robot.
    pub joints: Vec<String>,
    /// Parameters by symbol.
    pub parameters: BTreeMap<String, f64>,
    /// RMS torque it is behind, over joints; `None` if the answer does not say [Nm].
    pub rms_nm: Option<f64>,
}

/// Root of the sum of squares.
pub fn norm(v: &[f64]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

impl Hidden {
    /// Share of effect `k` in the RMS of everything that a model without any of them leaves: all effects and what
    /// the true model itself would leave. `None` where the answer does not say how strong the effects are.
    pub fn share(&self, k: usize) -> Option<f64> {
        let sizes: Vec<f64> = self.effects.iter().map(|e| e.rms_nm).collect::<Option<_>>()?;
        let all = (norm(&sizes).powi(2) + norm(&self.oracle_rms_nm).powi(2)).sqrt();
        let own = sizes.get(k)?;
        (all > 0.0).then(|| own / all)
    }

    /// From the simulator's answer.
    pub fn of_truth(truth: &Truth) -> Self {
        let effects = truth.effects.iter().map(|e| Effect {
            id: e.id.clone(),
            unknown: !e.in_catalogue(),
            also_accept: e.also_accept.clone(),
            joints: e.joints.clone(),
            parameters: e.params.clone(),
            rms_nm: (!e.rms_nm.is_empty()).then(|| norm(&e.rms_nm)),
        });
        let carried = truth.events.iter().flat_map(|(file, events)| {
            let loads = events.iter().filter(|e| e.kind == "payload");
            loads.map(move |e| (file.clone(), e.t_on, e.t_off, e.mass))
        });
        Self {
            effects: effects.collect(),
            frictionless: truth.base == "ideal",
            oracle_rms_nm: truth.oracle.from_csv_rms_40hz.clone(),
            carried: carried.collect(),
        }
    }

    /// From a key of another engine (`delta_concealed/keys`).
    ///
    /// # Errors
    /// [`BadInput`] with the line.
    pub fn of_key(text: &str) -> Result<Self, BadInput> {
        let key: Key = serde_json::from_str(text).map_err(|e| BadInput::new(e.to_string()).at_line(e.line() as u64))?;
        let effects = key.effects.into_iter().filter(|e| e.cls != "null_control").map(|e| Effect {
            unknown: e.cls == "unknown",
            joints: match e.joints {
                // Other engines number the joints; a Delta's are q1, q2, q3.
                KeyJoints::Numbers(list) => list.iter().map(|j| format!("q{j}")).collect(),
                KeyJoints::Words(_) => Vec::new(),
            },
            parameters: e.params.iter().filter_map(|(k, v)| Some((k.clone(), v.as_f64()?))).collect(),
            id: e.id,
            also_accept: e.also_accept,
            rms_nm: None,
        });
        let carried = key.events.iter().flat_map(|(file, events)| {
            let loads = events.iter().filter(|e| e.kind == "payload");
            loads.filter_map(move |e| Some((file.clone(), e.t_on?, e.t_off?, e.mass?)))
        });
        Ok(Self {
            effects: effects.collect(),
            frictionless: key.base == "ideal",
            oracle_rms_nm: key.oracle.from_csv_rms,
            carried: carried.collect(),
        })
    }
}

#[derive(Deserialize)]
struct Key {
    base: String,
    effects: Vec<KeyEffect>,
    oracle: KeyOracle,
    #[serde(default)]
    events: BTreeMap<String, Vec<KeyEvent>>,
}

#[derive(Deserialize)]
struct KeyEvent {
    kind: String,
    t_on: Option<f64>,
    t_off: Option<f64>,
    mass: Option<f64>,
}

#[derive(Deserialize)]
struct KeyEffect {
    id: String,
    cls: String,
    #[serde(default)]
    also_accept: Vec<String>,
    joints: KeyJoints,
    #[serde(default)]
    params: BTreeMap<String, serde_json::Value>,
}

#[derive(Deserialize)]
#[serde(untagged)]
enum KeyJoints {
    Numbers(Vec<u64>),
    Words(#[allow(dead_code, reason = "read to be passed over")] String),
}

#[derive(Deserialize)]
struct KeyOracle {
    #[serde(rename = "from_csv_rms_40Hz")]
    from_csv_rms: Vec<f64>,
}
