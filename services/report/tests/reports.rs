//! Whole reports: what no input may do to them.

mod gallery;

use lacuna_report::*;

/// Names a hostile or careless user could give a joint, a file, a robot.
const HOSTILE: [&str; 6] = [
    "</script><script>alert(1)</script>",
    "\"><img src=x onerror=alert(1)>",
    "'; alert(1); //",
    "<!--<script>",
    "a\u{0}b\u{202e}c\u{2028}d",
    "]]></style></title><svg/onload=alert(1)>",
];

/// The elements a report may contain. Whatever a name smuggles in would add another, or a handler.
fn assert_inert(html: &str) {
    assert_eq!(html.matches("<script").count(), 3, "data, uPlot, report script");
    assert_eq!(html.matches("</script").count(), 3);
    assert_eq!(html.matches("<style").count(), 2);
    for forbidden in ["<img", "<iframe", "<link", "<object", "<embed", "<svg/", "<!--", "@import", "url("] {
        assert!(!html.contains(forbidden), "{forbidden} in the report");
    }
    // Attributes are only ever written by us; an event handler among them would be an injection.
    let body = html.split("<body>").nth(1).and_then(|b| b.split("<script").next()).expect("a body");
    let tags = body.split('<').filter_map(|piece| piece.split('>').next());
    for tag in tags {
        // What stands in quotes is a value, whatever it says.
        let bare: String = tag.split('"').step_by(2).collect();
        assert!(!["onerror", "onload", "src", "alert"].iter().any(|word| bare.contains(word)), "<{tag}>");
    }
    assert!(html.len() < MAX_BYTES, "{} bytes", html.len());
}

fn renamed_trace(trace: &mut TorqueTrace, name: &str) {
    name.clone_into(&mut trace.recording);
    for joint in &mut trace.joints {
        name.clone_into(&mut joint.joint);
        for model in &mut joint.models {
            name.clone_into(&mut model.name);
        }
    }
}

#[test]
fn hostile_names_stay_text() {
    for name in HOSTILE {
        let mut data = gallery::identification();
        data.traces.truncate(1);
        data.traces.iter_mut().for_each(|t| renamed_trace(t, name));
        name.clone_into(&mut data.robot);
        name.clone_into(&mut data.verdict);
        name.clone_into(&mut data.torque_unit);
        data.warnings.push(name.to_owned());
        data.parameters.iter_mut().for_each(|p| {
            name.clone_into(&mut p.symbol);
            p.merged_with.push(name.to_owned());
        });
        assert_inert(&identification_report(&data));

        let mut data = gallery::diagnosis();
        data.traces.truncate(1);
        data.traces.iter_mut().for_each(|t| renamed_trace(t, name));
        for finding in &mut data.findings {
            for field in [&mut finding.effect, &mut finding.title, &mut finding.sentence, &mut finding.equation] {
                name.clone_into(field);
            }
            finding.joints = vec![name.to_owned()];
            finding.regions.iter_mut().for_each(|r| name.clone_into(&mut r.variable));
        }
        if let Some(map) = data.unknown.as_mut().and_then(|u| u.map.as_mut()) {
            name.clone_into(&mut map.caption);
            name.clone_into(&mut map.x_label);
        }
        data.excluded.push(Excluded { effect: name.to_owned(), reason: name.to_owned() });
        assert_inert(&diagnosis_report(&data));
    }
}

#[test]
fn pictures_are_well_formed_whatever_the_names() {
    for name in HOSTILE {
        let mut trace = gallery::trace("t", 0, &["M_KH", "M_Id", "M_Id+F"]);
        renamed_trace(&mut trace, name);
        let svg = overlay_svg(&OverlayPicture { title: name, torque_unit: name, trace: &trace, window_s: None });
        let document = roxmltree::Document::parse(&svg).expect("well-formed XML");
        assert_eq!(document.descendants().filter(|n| n.has_tag_name("script")).count(), 0);
        let mut table = gallery::table_1(&gallery::trace("t", 0, &["a", "b", "c"]));
        name.clone_into(&mut table.caption);
        table.models.iter_mut().for_each(|m| name.clone_into(m));
        let svg = table_picture(&table, name);
        assert!(roxmltree::Document::parse(&svg).is_ok());
    }
}

#[test]
fn the_overlay_states_the_error_of_each_model() {
    // One joint, τ = sin, the model 0.5 too low every second sample: σ = 0.25 by hand.
    let t_s: Vec<f64> = (0..1000).map(|i| f64::from(i) * 0.01).collect();
    let measured: Vec<f64> = t_s.iter().map(|t| t.sin()).collect();
    let model = measured.iter().enumerate().map(|(i, m)| if i % 2 == 0 { m - 0.5 } else { *m }).collect();
    let models = vec![NamedSeries { name: "M_Id".into(), values: model }];
    let joint = JointTrace { joint: "q1".into(), measured, models, ..JointTrace::default() };
    let trace = TorqueTrace { recording: String::new(), t_s, joints: vec![joint] };
    let svg = overlay_svg(&OverlayPicture { title: "", torque_unit: "Nm", trace: &trace, window_s: None });
    assert!(svg.contains("σ 0.250 Nm"), "{}", &svg[svg.len().saturating_sub(600)..]);
    let outside =
        overlay_svg(&OverlayPicture { title: "", torque_unit: "Nm", trace: &trace, window_s: Some((50.0, 60.0)) });
    assert!(roxmltree::Document::parse(&outside).is_ok() && outside.contains("no time to show"));
}

#[test]
fn empty_data_make_a_short_honest_report() {
    let html = identification_report(&IdentificationReportData::default());
    assert_inert(&html);
    assert!(!html.contains("data-chart=\"0\""));
    let html = diagnosis_report(&DiagnosisReportData::default());
    assert_inert(&html);
    assert!(html.contains("No mismatch beyond noise"));
    assert!(Report::default().to_html().contains("</html>"));
    assert!(roxmltree::Document::parse(&table_picture(&ErrorTable::default(), "Nm")).is_ok());
}

/// Every number of a struct replaced by NaN and infinities: the report says "–" and never "NaN".
#[test]
fn what_is_not_a_number_is_not_shown_as_one() {
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX, f64::MIN_POSITIVE] {
        let mut data = gallery::diagnosis();
        data.traces.truncate(1);
        for joint in data.traces.iter_mut().flat_map(|t| &mut t.joints) {
            joint.measured.iter_mut().skip(100).step_by(7).for_each(|v| *v = bad);
            joint.qd_rad_s.iter_mut().skip(50).step_by(11).for_each(|v| *v = bad);
            joint.models[1].values = vec![bad; joint.measured.len()];
        }
        data.traces[0].t_s.iter_mut().skip(200).step_by(13).for_each(|v| *v = bad);
        data.relative_before = Some(bad);
        data.relative_after_ci95 = Some((bad, bad));
        data.located.iter_mut().for_each(|l| (l.share, l.size) = (bad, Some(bad)));
        data.held_out.iter_mut().for_each(|h| (h.before_rms, h.after_ci95) = (bad, Some((bad, bad))));
        for finding in &mut data.findings {
            finding.held_out = Some(Gain { before_rms: bad, after_rms: bad, reduction: bad, ci95: Some((bad, bad)) });
            finding.regions.iter_mut().for_each(|r| (r.low, r.high) = (bad, bad));
            finding.parameters.iter_mut().for_each(|p| (p.value, p.ci95) = (bad, Some((bad, bad))));
        }
        if let Some(map) = data.unknown.as_mut().and_then(|u| u.map.as_mut()) {
            map.rows.iter_mut().flatten().for_each(|v| *v = bad);
        }
        let html = diagnosis_report(&data);
        assert_inert(&html);
        let body = html.split("<script").next().expect("text before the scripts");
        assert!(!body.contains("NaN") && !body.contains(">inf") && !body.contains(" inf"), "{bad} shows");
    }
}

#[test]
fn the_same_data_give_the_same_bytes() {
    assert_eq!(diagnosis_report(&gallery::diagnosis()), diagnosis_report(&gallery::diagnosis()));
    assert_eq!(identification_report(&gallery::identification()), identification_report(&gallery::identification()));
}

/// Eight joints, four models, ten minutes at 100 Hz in each of three recordings: still under 5 MB.
#[test]
fn a_long_recording_of_many_joints_fits() {
    let models = ["M_KH", "M_Id", "M_Id+F", "pooled"];
    let mut data = gallery::identification();
    data.traces = (0..3)
        .map(|number| {
            let short = gallery::trace("long.csv", number, &models);
            let repeated = |v: &Vec<f64>| v.iter().cycle().take(60_000).copied().collect::<Vec<f64>>();
            let joint = |k: usize| {
                let j = &short.joints[k % 3];
                JointTrace {
                    joint: format!("axis {k}"),
                    measured: repeated(&j.measured),
                    q_rad: repeated(&j.q_rad),
                    qd_rad_s: repeated(&j.qd_rad_s),
                    variables: Vec::new(),
                    models: j
                        .models
                        .iter()
                        .map(|m| NamedSeries { name: m.name.clone(), values: repeated(&m.values) })
                        .collect(),
                }
            };
            TorqueTrace {
                recording: format!("long_{number}.csv"),
                t_s: (0..60_000).map(|i| f64::from(i) * 0.01).collect(),
                joints: (0..8).map(joint).collect(),
            }
        })
        .collect();
    let html = identification_report(&data);
    assert_inert(&html);
    assert!(html.contains("data-chart=\"47\""), "3 recordings × 8 joints × 2 charts are all there");
    data.warnings = vec!["x".repeat(100_000); 10_000];
    data.repairs = vec![RepairRow { file: "f".repeat(100_000), kind: "spike".into(), count: 1 }; 5000];
    let html = identification_report(&data);
    assert!(html.len() < MAX_BYTES, "{} bytes", html.len());
}

#[test]
fn the_words_and_figures_given_are_in_the_report() {
    let data = gallery::diagnosis();
    let html = diagnosis_report(&data);
    for words in [
        data.verdict.as_str(),
        data.findings[0].sentence.as_str(),
        "v<sub>s</sub>",
        "0.123 to 0.159",
        "worsens held-out by 5 %",
        "velocity −0.2 to 0.2 rad/s",
        "lacuna excite --robot robot.toml --separate stribeck,viscous_power",
    ] {
        assert!(html.contains(words), "{words}");
    }
    let html = identification_report(&gallery::identification());
    for words in [
        "J<sub>r,1</sub>, m<sub>2</sub> l<sub>1</sub><sup>2</sup>",
        "0.9012",
        "not told apart from zero",
        "nominal outside the interval",
        "poorly excited",
    ] {
        assert!(html.contains(words), "{words}");
    }
}
