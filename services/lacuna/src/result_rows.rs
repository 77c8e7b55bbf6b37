//! `result.parquet`: one row per joint of an identification, per finding of a diagnosis. docs/FLEET.md lists the columns.

use lacuna_diagnose::findings::{Finding, Findings};
use lacuna_export::rows::CellKind::{Count, Flag, Number, Text};
use lacuna_export::rows::{Cell, CellKind, ResultColumn, to_parquet};
use lacuna_identify::outcome::Identification;
use lacuna_stage::Failure;

/// What both kinds of rows begin with.
#[derive(Debug, Clone)]
pub struct Origin<'a> {
    /// What the user calls this set (`--label`).
    pub label: Option<&'a str>,
    /// Hash of all that the result depends on.
    pub set: &'a str,
    /// File names of the recordings.
    pub recordings: &'a [String],
}

const fn column(name: &'static str, kind: CellKind, meaning: &'static str) -> ResultColumn {
    ResultColumn { name, kind, meaning }
}

/// Columns of `lacuna identify`, one row per joint.
pub const IDENTIFY: &[ResultColumn] = &[
    column("robot", Text, "name in the robot file"),
    column("label", Text, "what --label said: serial number, cell, date"),
    column("set", Text, "hash of recordings, robot file, options and program"),
    column("version", Text, "version of Lacuna"),
    column("recordings", Text, "file names of the recordings, separated by ;"),
    column("method", Text, "pooled or paper"),
    column("split", Text, "how the held-out data were chosen"),
    column("torque_unit", Text, "unit of every torque in this row"),
    column("relative_error", Number, "held-out torque error over the torque, all joints"),
    column("nominal_relative_error", Number, "the same of the robot file's own model; null without masses"),
    column("warnings", Count, "warnings of the identification"),
    column("joint", Text, "name of the joint"),
    column("joint_index", Count, "number of the joint, from 1"),
    column("joint_relative_error", Number, "held-out torque error over the torque of this joint"),
    column("rms_nm", Number, "root mean square of the held-out residual"),
    column("mean_nm", Number, "mean of the held-out residual"),
    column("std_nm", Number, "standard deviation of the held-out residual"),
    column("noise_nm", Number, "standard deviation of the residual over the fitted rows"),
    column("rows", Count, "rows fitted"),
    column("f_c", Number, "Coulomb friction"),
    column("f_c_low", Number, "lower end of its 95 % interval"),
    column("f_c_high", Number, "upper end of its 95 % interval"),
    column("f_v", Number, "viscous friction, torque unit s/rad"),
    column("f_v_low", Number, "lower end of its 95 % interval"),
    column("f_v_high", Number, "upper end of its 95 % interval"),
];

/// Columns of `lacuna diagnose`, one row per finding; of a robot without one, a single row with an empty `effect`.
pub const DIAGNOSE: &[ResultColumn] = &[
    column("robot", Text, "name in the robot file"),
    column("label", Text, "what --label said: serial number, cell, date"),
    column("set", Text, "hash of recordings, robot file, options and program"),
    column("version", Text, "version of Lacuna"),
    column("recordings", Text, "file names of the recordings, separated by ;"),
    column("detected", Flag, "whether anything is missing beyond noise and tolerances"),
    column("significance", Number, "probability of as much evidence if nothing were missing"),
    column("relative_before", Number, "held-out torque error over the torque, model without findings"),
    column("relative_after", Number, "the same with all findings"),
    column("unknown", Flag, "whether an unexplained rest is large enough to be told"),
    column("unknown_share", Number, "share of the residual power that no named effect explains"),
    column("findings", Count, "number of findings"),
    column("finding_index", Count, "number of the finding, from 1, the largest gain first; null without one"),
    column("effect", Text, "effect of the catalogue, or unknown; null without a finding"),
    column("joints", Text, "joints it acts on, separated by ;"),
    column("probability", Number, "probability that it or its group is there"),
    column("status", Text, "named, group or unknown"),
    column("group", Text, "effects that the data do not tell apart from it, separated by ;"),
    column("before_rms_nm", Number, "held-out residual without it"),
    column("after_rms_nm", Number, "held-out residual with it"),
    column("reduction", Number, "1 − after/before"),
    column("reduction_low", Number, "lower end of its 95 % interval"),
    column("reduction_high", Number, "upper end of its 95 % interval"),
    column("parameters", Text, "its fitted numbers as JSON: symbol, unit, value, ci95, joint"),
    column("sentence", Text, "the finding in words"),
    column("verdict", Text, "the diagnosis in words"),
];

impl Origin<'_> {
    fn cells(&self, robot: &str) -> Vec<Cell> {
        vec![
            robot.into(),
            Cell::Text(self.label.map(str::to_owned)),
            self.set.into(),
            env!("CARGO_PKG_VERSION").into(),
            self.recordings.join(";").as_str().into(),
        ]
    }
}

/// The bytes of `result.parquet` of an identification.
///
/// # Errors
/// If they cannot be made.
pub fn identify(id: &Identification, origin: &Origin<'_>) -> Result<Vec<u8>, Failure> {
    let held = &id.held_out;
    let rows: Vec<Vec<Cell>> = id
        .joints
        .iter()
        .enumerate()
        .map(|(j, joint)| {
            let of = |list: &[f64]| Cell::from(list.get(j).copied());
            let mut row = origin.cells(&id.robot);
            row.extend([
                id.method.as_str().into(),
                held.split.as_str().into(),
                id.torque_unit.as_str().into(),
                held.score.relative_error.into(),
                held.nominal_relative_error.into(),
                id.warnings.len().into(),
                joint.as_str().into(),
                (j + 1).into(),
                of(&held.score.relative_error_per_joint),
                of(&held.score.rms_nm),
                of(&held.score.mean_nm),
                of(&held.score.std_nm),
                of(&id.noise_nm),
                Cell::Count(id.rows.get(j).and_then(|n| i64::try_from(*n).ok())),
            ]);
            for symbol in ["f_c", "f_v"] {
                let symbol = format!("{symbol}{}", j + 1);
                let found = id.parameters.iter().find(|p| p.symbol == symbol);
                row.push(found.map(|p| p.value).into());
                row.push(found.map(|p| p.ci95[0]).into());
                row.push(found.map(|p| p.ci95[1]).into());
            }
            row
        })
        .collect();
    to_parquet("lacuna.identify-rows/1", IDENTIFY, &rows).map_err(|e| Failure::run(format!("result.parquet: {e}")))
}

/// The bytes of `result.parquet` of a diagnosis.
///
/// # Errors
/// If they cannot be made.
pub fn diagnose(findings: &Findings, origin: &Origin<'_>) -> Result<Vec<u8>, Failure> {
    let all = |finding: Option<(usize, &Finding)>| -> Result<Vec<Cell>, Failure> {
        let mut row = origin.cells(&findings.robot);
        row.extend([
            findings.mismatch.detected.into(),
            findings.mismatch.significance.into(),
            findings.held_out.relative_before.into(),
            findings.held_out.relative_after.into(),
            findings.unknown.flag.into(),
            findings.unknown.share.into(),
            findings.findings.len().into(),
        ]);
        match finding {
            Some((index, finding)) => row.extend(of_finding(index, finding)?),
            None => row.extend([
                Cell::Count(None),
                Cell::Text(None),
                Cell::Text(None),
                Cell::Number(None),
                Cell::Text(None),
                Cell::Text(None),
                Cell::Number(None),
                Cell::Number(None),
                Cell::Number(None),
                Cell::Number(None),
                Cell::Number(None),
                Cell::Text(None),
                Cell::Text(None),
            ]),
        }
        row.push(findings.verdict.as_str().into());
        Ok(row)
    };
    // A robot without a finding is counted as well.
    let rows: Vec<Vec<Cell>> = if findings.findings.is_empty() {
        vec![all(None)?]
    } else {
        findings.findings.iter().enumerate().map(|f| all(Some(f))).collect::<Result<_, _>>()?
    };
    to_parquet("lacuna.diagnose-rows/1", DIAGNOSE, &rows).map_err(|e| Failure::run(format!("result.parquet: {e}")))
}

fn of_finding(index: usize, f: &Finding) -> Result<[Cell; 13], Failure> {
    let parameters = serde_json::to_string(&f.parameters).map_err(|e| Failure::run(format!("result.parquet: {e}")))?;
    let gain = &f.held_out;
    let others: Vec<&str> = f.group.iter().map(String::as_str).filter(|id| *id != f.effect).collect();
    Ok([
        (index + 1).into(),
        f.effect.as_str().into(),
        f.joints.join(";").as_str().into(),
        f.probability.into(),
        f.status.as_str().into(),
        others.join(";").as_str().into(),
        gain.before_rms_nm.into(),
        gain.after_rms_nm.into(),
        gain.reduction.into(),
        gain.ci95[0].into(),
        gain.ci95[1].into(),
        parameters.as_str().into(),
        f.sentence.as_str().into(),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_on_fleets_lists_every_column() {
        let page = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/FLEET.md");
        let page = std::fs::read_to_string(page).unwrap();
        for column in IDENTIFY.iter().chain(DIAGNOSE) {
            let row = format!("| `{}` | {} |", column.name, column.meaning);
            assert!(page.contains(&row), "docs/FLEET.md should hold: {row}");
        }
    }
}
