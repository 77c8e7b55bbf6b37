//! Invented data for looking at reports: a three-axis robot whose second joint sticks before it slides.
//!
//! The motion is a sum of sines, the torques are closed forms, the noise is a linear congruential
//! generator: nothing here comes from a robot, and nothing was fitted. The figures in the tables are
//! computed from the series where that is easy and written down where it is not.

use lacuna_report::*;

const JOINTS: [&str; 3] = ["q1", "q2", "q3"];
const STEP_S: f64 = 0.002;

fn series(name: &str, values: Vec<f64>) -> NamedSeries {
    NamedSeries { name: name.to_owned(), values }
}

/// Uniform noise with standard deviation 1, the same on every machine.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 11) as f64 / (1_u64 << 53) as f64 - 0.5) * 12.0_f64.sqrt()
    }
}

/// One recording of 16 s; `number` sets phases and noise.
pub fn trace(recording: &str, number: u32, models: &[&str]) -> TorqueTrace {
    let t_s: Vec<f64> = (0..8000).map(|i| f64::from(i) * STEP_S).collect();
    let mut noise = Noise(u64::from(number) + 1);
    let joint = |(j, name): (usize, &&str)| {
        let mut joint = JointTrace { joint: (*name).to_owned(), ..JointTrace::default() };
        joint.models = models.iter().map(|m| series(m, Vec::new())).collect();
        for (i, t) in t_s.iter().enumerate() {
            let (w, phase) = (1.3 + 0.4 * j as f64, f64::from(number) * 0.9 + j as f64);
            let q = 0.5 * (w * t + phase).sin() + 0.18 * (2.7 * w * t).sin();
            let qd = 0.5 * w * (w * t + phase).cos() + 0.486 * w * (2.7 * w * t).cos();
            let qdd = -0.5 * w * w * (w * t + phase).sin() - 1.3122 * w * w * (2.7 * w * t).sin();
            let inertia = 0.9 * qdd + 4.0 * (q + 0.2).cos();
            let friction = 0.6 * qd + 0.8 * (qd / 0.01).tanh();
            let sticking = if j == 1 { 0.9 * (-(qd / 0.14_f64).powi(2)).exp() * (qd / 0.01).tanh() } else { 0.0 };
            let spike = if j == 0 && i == 5321 && number == 0 { 3.5 } else { 0.0 };
            joint.q_rad.push(q);
            joint.qd_rad_s.push(qd);
            joint.measured.push(inertia + friction + sticking + 0.06 * noise.next() + spike);
            let stages = [0.7 * inertia, inertia, inertia + friction, inertia + friction + 0.97 * sticking];
            let offset = stages.len() - models.len().min(4);
            for (k, model) in joint.models.iter_mut().enumerate() {
                model.values.push(stages[(offset + k).min(3)] + if k >= 2 && offset == 2 { 0.02 * q } else { 0.0 });
            }
        }
        joint
    };
    let joints = JOINTS.iter().enumerate().map(joint).collect();
    TorqueTrace { recording: recording.to_owned(), t_s, joints }
}

fn rms(values: impl Iterator<Item = f64>) -> (f64, f64, f64) {
    let values: Vec<f64> = values.collect();
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let square = values.iter().map(|v| v * v).sum::<f64>() / n;
    (square.sqrt(), mean, (square - mean * mean).max(0.0).sqrt())
}

fn error(joint: &JointTrace, model: usize) -> (f64, f64, f64) {
    rms(joint.measured.iter().zip(&joint.models[model].values).map(|(m, p)| m - p))
}

fn relative(trace: &TorqueTrace, model: usize) -> f64 {
    let pooled = |f: &dyn Fn(&JointTrace) -> f64| trace.joints.iter().map(|j| f(j).powi(2)).sum::<f64>();
    (pooled(&|j| error(j, model).0) / pooled(&|j| rms(j.measured.iter().copied()).0)).sqrt()
}

fn setup() -> Setup {
    let whole = |name: &str| Stretch { recording: name.to_owned(), ..Stretch::default() };
    Setup {
        train: vec![
            whole("traj_01.csv"),
            Stretch { recording: "traj_02.csv".into(), from_s: Some(0.0), to_s: Some(8.0) },
        ],
        test: vec![whole("traj_03.csv"), whole("traj_04.csv")],
        band_hz: Some(40.0),
        moving_rad_s: Some(0.05),
        samples: Some(48_000),
        further: vec![("Delay".into(), "torque 0.31 ms behind position, compensated".into())],
    }
}

fn parameter(symbol: &str, joint: &str, meaning: &str, unit: &str, value: f64, half: f64) -> ParameterRow {
    ParameterRow {
        symbol: symbol.into(),
        joint: joint.into(),
        meaning: meaning.into(),
        unit: unit.into(),
        value,
        ci95: Some((value - half, value + half)),
        ..ParameterRow::default()
    }
}

fn repairs() -> Vec<RepairRow> {
    vec![
        RepairRow { file: "traj_01.csv".into(), kind: "single-sample torque spike".into(), count: 3 },
        RepairRow { file: "traj_04.csv".into(), kind: "wrapped angle".into(), count: 1 },
    ]
}

/// Table 1 of the trace: three models.
pub fn table_1(trace: &TorqueTrace) -> ErrorTable {
    let row = |j: &JointTrace| (0..3).map(|m| error(j, m)).map(|(_, mean, std)| (mean, std)).collect();
    ErrorTable {
        caption: "Mean and standard deviation of the torque error over traj_03.csv".into(),
        models: ["M_KH", "M_Id", "M_{Id+F}"].map(String::from).to_vec(),
        joints: JOINTS.map(String::from).to_vec(),
        errors: trace.joints.iter().map(row).collect(),
    }
}

fn payload() -> PayloadTrace {
    let t_s: Vec<f64> = (0..4000).map(|i| f64::from(i) * 0.004).collect();
    let carried = |t: f64| (3.0..7.0).contains(&t) || (9.5..13.5).contains(&t);
    let true_kg: Vec<f64> = t_s.iter().map(|t| if carried(*t) { 3.8 } else { 0.0 }).collect();
    let mut state = 0.0;
    let mut noise = Noise(7);
    let follow = |m: &f64| {
        state += (m - state) * 0.03;
        state + 0.02 * noise.next()
    };
    PayloadTrace {
        source: "measured torque".into(),
        estimate_kg: true_kg.iter().map(follow).collect(),
        t_s,
        true_kg,
        known: true,
    }
}

/// An identification report with every part filled.
pub fn identification() -> IdentificationReportData {
    let models = ["M_KH", "M_Id", "M_Id+F", "pooled fit"];
    let traces = vec![trace("traj_03.csv", 0, &models), trace("traj_04.csv", 1, &models)];
    let first = &traces[0];
    let held_out = first.joints.iter().map(|j| {
        let (rms, mean, std) = error(j, 3);
        let relative_error = rms / self::rms(j.measured.iter().copied()).0;
        HeldOutRow { joint: j.joint.clone(), rms, mean, std, relative_error, noise_floor: Some(0.06) }
    });
    let method = |k: usize, note: &str| MethodRow {
        name: models[k].into(),
        relative_error: relative(first, k),
        rms: first.joints.iter().map(|j| error(j, k).0).collect(),
        note: note.into(),
    };
    let mut parameters = vec![
        parameter("I_1", "q1", "inertia about the joint", "kg m²", 0.9012, 0.0041),
        parameter("f_v", "q1", "viscous friction", "Nm s/rad", 0.604, 0.011),
        parameter("f_c", "q1", "Coulomb friction", "Nm", 0.797, 0.016),
        parameter("τ_0", "q1", "offset", "Nm", 0.004, 0.013),
        parameter("f_v", "q2", "viscous friction", "Nm s/rad", 0.588, 0.012),
        parameter("m_0 g", "", "platform weight", "N", 12.43, 0.21),
    ];
    parameters[0].merged_with = vec!["J_{r,1}".into(), "m_2 l_1^2".into()];
    parameters[5].nominal = Some(11.77);
    IdentificationReportData {
        robot: "delta_d3 (invented example)".into(),
        method: "pooled weighted least squares, robust, exact differentiators".into(),
        verdict: "The identified model predicts the torque of recordings it had not seen to within 2 %; \
                  joint 2 is the worst, and what remains there sits below 0.2 rad/s."
            .into(),
        tone: Tone::Good,
        setup: setup(),
        relative_error: Some(relative(first, 3)),
        relative_error_ci95: Some((relative(first, 3) * 0.92, relative(first, 3) * 1.09)),
        relative_error_nominal: Some(relative(first, 0)),
        held_out: held_out.collect(),
        methods: vec![
            method(0, "nominal robot file"),
            method(1, "inertia and gravity scaled"),
            method(2, "plus friction, averages over trajectories"),
            method(3, "all parameters at once"),
        ],
        parameters,
        not_excited: vec![NotExcited {
            symbol: "f_{c,4}".into(),
            reason: "joint 4 moved 0.02 rad in all: 3 samples above 0.05 rad/s".into(),
        }],
        conditioning: vec![
            ConditionRow { what: "regressor, columns scaled".into(), value: 37.2, limit: Some(100.0) },
            ConditionRow { what: "friction of joint 3".into(), value: 412.0, limit: Some(100.0) },
        ],
        table_1: Some(table_1(first)),
        table_2: Some(ErrorTable {
            caption: "Torque error of M_Id+F on pick and place, without and with the payload".into(),
            models: ["m_p = 0".into(), "m_p estimated".into()].to_vec(),
            joints: JOINTS.map(String::from).to_vec(),
            errors: vec![vec![(4.1, 7.9), (0.2, 1.1)], vec![(3.8, 7.1), (0.1, 1.0)], vec![(-4.0, 7.4), (-0.3, 1.2)]],
        }),
        payload: vec![payload()],
        payload_rows: vec![PayloadRow {
            recording: "traj_02.csv".into(),
            source: "measured torque".into(),
            picked_s: Some(1.2),
            placed_s: Some(3.4),
            mass_kg: Some(3.79),
            sd_kg: Some(0.02),
            known_kg: Some(3.8),
            settled_after_s: Some(0.11),
            zero_after_s: None,
        }],
        forward: Some(ForwardErrors {
            horizons_s: vec![0.05, 0.1, 0.2],
            joints: ["q1", "q2", "q3"].map(str::to_owned).to_vec(),
            identified: vec![vec![2e-4, 3e-4, 2e-4], vec![7e-4, 9e-4, 8e-4], vec![2.4e-3, 2.9e-3, 2e-3]],
            others: vec![("Velocity held".into(), vec![0.24, 0.12, 0.06])],
            note: "120 windows of held-out motion.".into(),
        }),
        warnings: vec![
            "Joint 2 stands still for 19 % of traj_04.csv; these samples are not judged, since a stuck joint \
             holds any torque within its static friction."
                .into(),
        ],
        repairs: repairs(),
        traces,
        torque_unit: String::new(),
    }
}

fn finding(trace: &TorqueTrace) -> Finding {
    let (before, after) = (error(&trace.joints[1], 0).0, error(&trace.joints[1], 1).0);
    let reduction = 1.0 - after / before;
    Finding {
        effect: "stribeck".into(),
        title: "Stribeck friction".into(),
        joints: vec!["q2".into()],
        probability: Some(0.97),
        status: "named".into(),
        sentence: "Joint 2 sticks before it slides: below 0.2 rad/s the model misses up to 0.9 Nm; a Stribeck \
                   term (v_s = 0.14 ± 0.02 rad/s) removes most of it on recordings it had not seen."
            .into(),
        equation: "τ_f = (f_s − f_c) e^{−(θ̇/v_s)²} sgn θ̇".into(),
        group: vec!["stribeck".into()],
        alternatives: vec![("viscous_power".into(), 0.02), ("presliding".into(), 0.01)],
        parameters: vec![
            parameter("v_s", "q2", "Stribeck speed", "rad/s", 0.141, 0.018),
            parameter("f_s − f_c", "q2", "break-away above Coulomb", "Nm", 0.88, 0.05),
        ],
        held_out: Some(Gain {
            before_rms: before,
            after_rms: after,
            reduction,
            ci95: Some((reduction - 0.05, reduction + 0.04)),
        }),
        regions: vec![Region { variable: "qd_rad_s".into(), low: -0.2, high: 0.2 }],
        intervals: Vec::new(),
    }
}

fn unknown() -> Unknown {
    let cell = |r: usize, c: usize| {
        let (x, y) = (c as f64 / 23.0 * 2.0 - 1.0, r as f64 / 11.0 * 2.0 - 1.0);
        if x * x + y * y > 1.7 { f64::NAN } else { 0.05 * (4.0 * x).sin() * (1.0 - y * y) }
    };
    Unknown {
        share: 0.021,
        sentence: "A small periodic remainder on joint 3, below the floor at which a name would be given.".into(),
        expression: "0.05 sin(4 q_3)".into(),
        map: Some(HeatMap {
            caption: "Mean residual of joint 3".into(),
            x_label: "Angle [rad]".into(),
            y_label: "Velocity [rad/s]".into(),
            value_label: "Mean residual [Nm]".into(),
            x_range: (-0.68, 0.68),
            y_range: (-1.9, 1.9),
            rows: (0..12).map(|r| (0..24).map(|c| cell(r, c)).collect()).collect(),
        }),
    }
}

fn next_experiment() -> NextExperiment {
    let t_s: Vec<f64> = (0..2000).map(|i| f64::from(i) * 0.01).collect();
    let slow = |k: f64| t_s.iter().map(|t| 0.3 * (0.35 * k * t).sin() + 0.1 * (0.9 * t).sin()).collect();
    NextExperiment {
        sentence: "Sweep joint 2 slowly through ± 0.4 rad with reversals every 3 s: below 0.05 rad/s the two laws \
                   differ by 0.2 Nm, five times the noise."
            .into(),
        separates: vec!["stribeck".into(), "viscous_power".into()],
        command: "lacuna excite --robot robot.toml --separate stribeck,viscous_power".into(),
        positions_rad: vec![series("q1", slow(0.5)), series("q2", slow(1.0))],
        t_s,
    }
}

/// A diagnosis report with every part filled.
pub fn diagnosis() -> DiagnosisReportData {
    let models = ["rigid body and friction", "with Stribeck term"];
    let mut traces = vec![trace("traj_03.csv", 0, &models), trace("traj_04.csv", 1, &models)];
    for joint in traces.iter_mut().flat_map(|t| &mut t.joints) {
        let values = joint.models[1].values.iter().zip(&joint.qd_rad_s).map(|(v, qd)| v + 0.05 * (3.0 * qd).sin());
        let black_box = series("black box", values.collect());
        joint.models.push(black_box);
    }
    let first = &traces[0];
    let row = |j: &JointTrace| {
        let (before, after) = (error(j, 0).0, error(j, 1).0);
        let around = |v: f64| Some((v * 0.94, v * 1.07));
        BeforeAfterRow {
            joint: j.joint.clone(),
            before_rms: before,
            after_rms: after,
            before_ci95: around(before),
            after_ci95: around(after),
            black_box_rms: Some(error(j, 2).0),
            noise_floor: Some(0.06),
        }
    };
    let interval = |from_s, to_s| TimeInterval { recording: "traj_03.csv".into(), from_s, to_s };
    let located = |joint: &str, share, size| Located {
        joint: joint.into(),
        share,
        size: Some(size),
        stage: "friction".into(),
        ..Located::default()
    };
    let mut where_ = vec![located("q2", 0.86, 0.21), located("q3", 0.09, 0.061), located("q1", 0.05, 0.06)];
    where_[0].regions = vec![Region { variable: "qd_rad_s".into(), low: -0.2, high: 0.2 }];
    where_[0].intervals = vec![interval(2.1, 3.4), interval(8.2, 9.0)];
    DiagnosisReportData {
        robot: "delta_d3 (invented example)".into(),
        verdict: "Joint 2 sticks before it slides: a Stribeck term is missing from the friction model. With it \
                  the model is as good as the best black box."
            .into(),
        detected: true,
        significance: Some(1e-9),
        setup: setup(),
        located: where_,
        findings: vec![finding(first)],
        held_out: first.joints.iter().map(row).collect(),
        held_out_words: "on recordings used neither to select nor to fit".into(),
        relative_before: Some(relative(first, 0)),
        relative_after: Some(relative(first, 1)),
        relative_after_ci95: Some((relative(first, 1) * 0.93, relative(first, 1) * 1.08)),
        black_box_relative: Some(relative(first, 2)),
        black_box: "gradient boosting, 200 trees".into(),
        noise_relative: Some(0.0138),
        forward: vec![
            ForwardRow { joint: "q1".into(), off_rad: 0.0041, on_rad: 0.0040 },
            ForwardRow { joint: "q2".into(), off_rad: 0.0312, on_rad: 0.0052 },
            ForwardRow { joint: "q3".into(), off_rad: 0.0038, on_rad: 0.0038 },
        ],
        forward_words: "Position after 0.1 s from the recorded state, driven by the recorded torque.".into(),
        traces,
        unknown: Some(unknown()),
        excluded: vec![
            Excluded { effect: "coulomb_asym".into(), reason: "worsens held-out by 5 %".into() },
            Excluded { effect: "cogging".into(), reason: "amplitudes differ in phase between the two splits".into() },
        ],
        next_experiment: Some(next_experiment()),
        warnings: Vec::new(),
        repairs: repairs(),
        torque_unit: "Nm".into(),
    }
}
