//! Recording all streams of a 3-joint robot: nanoseconds per message and bytes per sample, per compression,
//! beside a bare `write` of the same bytes and the `mcap` crate's own writer.
//!
//! Run it with `cargo bench -p lacuna-recorder`. CPU time counts all threads.

use lacuna_interfaces::{
    FrictionTorque, Header, JointMeasured, JointSmoothed, Joints, PayloadEstimate, RobotFile, TorqueModel,
};
use lacuna_recorder::{Config, Recorder, Run, Stream};
use lacuna_recording::ros::cdr::Builder;
use std::collections::BTreeMap;
use std::hint::black_box;
use std::io::Write;
use std::path::Path;
use std::time::Instant;

const SAMPLES: u64 = 150_000;
/// Samples prepared beforehand and used in turn: few enough for the cache, more than a chunk holds.
const PREPARED: u64 = 1024;

/// A motion as a 20-bit encoder behind a gear of 33 and a drive with 0.1 mNm torque steps would log it, with
/// noise in everything that is derived.
struct Motion {
    noise: u64,
}

impl Motion {
    fn random(&mut self) -> f64 {
        // xorshift64: noise is noise.
        self.noise ^= self.noise << 13;
        self.noise ^= self.noise >> 7;
        self.noise ^= self.noise << 17;
        self.noise as f64 / u64::MAX as f64 - 0.5
    }

    fn joints(&mut self, mut f: impl FnMut(f64, f64) -> f64) -> Joints {
        std::array::from_fn(|j| if j < 3 { f(j as f64, self.random()) } else { 0.0 })
    }

    fn sample(&mut self, k: u64) -> All {
        let t = k as f64 * 1e-3;
        let header = Header {
            seq: k + 1,
            stamp_ns: k as i64 * 1_000_000,
            joints: 3,
            hops: 5,
            hop_ns: std::array::from_fn(|i| k * 7000 + i as u64 * 1000 + k % 97 * i as u64),
            ..Header::default()
        };
        let lsb = std::f64::consts::TAU / (1 << 20) as f64 / 33.0;
        let q = self.joints(|j, r| (((t * (1.0 + j)).sin() + r * 3.0 * lsb) / lsb).round() * lsb);
        let tau = self.joints(|j, r| (((t * 2.0 + j).cos() * 20.0 + r) * 1e4).round() / 1e4);
        let mut fine = |scale: f64| self.joints(|j, r| (t * (1.0 + j)).cos() * scale + r * 1e-3 * scale);
        let (qd, qdd, model) = (fine(1.0), fine(5.0), fine(20.0));
        let (friction, residual, after) = (fine(2.0), fine(0.5), fine(0.1));
        let nan = [f64::NAN; 8];
        All {
            measured: JointMeasured {
                header,
                q_rad: q,
                tau_nm: tau,
                temperature_degc: nan,
                link_q_rad: nan,
                link_tau_nm: nan,
            },
            smoothed: JointSmoothed {
                header,
                q_rad: q,
                qd_rad_s: qd,
                qdd_rad_s2: qdd,
                sd_q_rad: [1e-6; 8],
                sd_qd_rad_s: [1e-4; 8],
                sd_qdd_rad_s2: [1e-2; 8],
                tau_nm: tau,
                temperature_degc: nan,
            },
            torque: TorqueModel { header, tau_nominal_nm: model, tau_rigid_nm: model, ..TorqueModel::default() },
            friction: FrictionTorque { header, tau_friction_nm: friction, ..FrictionTorque::default() },
            payload: PayloadEstimate {
                header,
                residual_nm: residual,
                residual_payload_nm: after,
                mass_kg: after[0],
                sd_mass_kg: 0.01,
                ..PayloadEstimate::default()
            },
        }
    }
}

impl All {
    /// This sample at its place in the stream.
    fn number(&mut self, k: u64) {
        for header in [
            &mut self.measured.header,
            &mut self.smoothed.header,
            &mut self.torque.header,
            &mut self.friction.header,
            &mut self.payload.header,
        ] {
            header.seq = k + 1;
            header.stamp_ns = k as i64 * 1_000_000;
        }
    }
}

struct All {
    measured: JointMeasured,
    smoothed: JointSmoothed,
    torque: TorqueModel,
    friction: FrictionTorque,
    payload: PayloadEstimate,
}

/// User and system time of this process [s], to 10 ms.
fn cpu_s() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after_name = stat.rsplit(')').next().unwrap_or("");
    let ticks = |i| after_name.split_whitespace().nth(i).and_then(|t| t.parse::<f64>().ok()).unwrap_or(0.0);
    (ticks(11) + ticks(12)) / 100.0
}

fn report(what: &str, messages: u64, wall_s: f64, cpu_s: f64, bytes: u64) {
    println!(
        "{what:<28} {:>7.1} ns/message  {:>7.1} ns CPU  {:>6.2} M messages/s  {:>7.1} B/sample",
        wall_s * 1e9 / messages as f64,
        cpu_s * 1e9 / messages as f64,
        messages as f64 / wall_s / 1e6,
        bytes as f64 / SAMPLES as f64
    );
}

fn main() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let robot = RobotFile::parse(
        "kind = \"delta\"\nname = \"d\"\n[geometry]\nl1 = 0.35\nl2 = 0.88\nra = 0.2\nrb = 0.05\n[mass]\nplatform = 1.1\n\
         upper_arm = 1.8\nforearm_point = 0.22\n",
    )
    .expect("a valid robot file");
    let mut motion = Motion { noise: 88_172_645_463_325_252 };
    let mut samples: Vec<All> = (0..PREPARED).map(|k| motion.sample(k)).collect();

    encoding(&samples);
    let mut sizes = Vec::new();
    for (name, more) in [
        ("none", "compression = 'none'"),
        ("lz4", "compression = 'lz4'"),
        ("zstd -5", "compression = 'zstd'\nlevel = -5"),
        ("zstd 1", "compression = 'zstd'\nlevel = 1"),
        ("zstd 3", "compression = 'zstd'\nlevel = 3"),
    ] {
        let path = dir.path().join("a.mcap");
        sizes.push((name, record(&robot, &mut samples, &path, name, more)));
        if name == "none" {
            bare(&path, &dir.path().join("bare"));
        }
        if matches!(name, "none" | "lz4" | "zstd 1") {
            peer(&path, &dir.path().join("peer"), name);
        }
        std::fs::remove_file(&path).expect("the file was there");
    }
    for (name, bytes) in &sizes {
        println!("size ratio {name:<8} {:.2}", sizes[0].1 as f64 / *bytes as f64);
    }
}

/// The CDR part alone: one JointState with effort, into a buffer.
fn encoding(samples: &[All]) {
    let joints = ["q1", "q2", "q3"].map(str::to_owned);
    let template = Builder::stamped().strings(&joints).numbers(0).numbers(0).numbers(3).template();
    let mut out = Vec::with_capacity(template.size());
    let many = 30 * SAMPLES;
    let (start, cpu) = (Instant::now(), cpu_s());
    for (_, m) in (0..many).zip(samples.iter().cycle()) {
        out.clear();
        template.append(&mut out, m.torque.header.stamp_ns).numbers(&m.torque.tau_rigid_nm[..3]).done();
        black_box(&out);
    }
    let bytes = template.size() as u64 * SAMPLES;
    report("CDR of a JointState", many, start.elapsed().as_secs_f64(), cpu_s() - cpu, bytes);
}

fn record(robot: &RobotFile, samples: &mut [All], path: &Path, name: &str, more: &str) -> u64 {
    let config: Config = toml::from_str(&format!("path = '{}'\n{more}", path.display())).expect("a valid config");
    let run = Run {
        robot,
        streams: &Stream::ALL,
        branches: &[],
        resumed: false,
        live: false,
        attachments: Vec::new(),
        facts: BTreeMap::new(),
    };
    let (start, cpu) = (Instant::now(), cpu_s());
    let mut recorder = Recorder::new(&config, &run).expect("a new file");
    for (k, i) in (0..SAMPLES).zip((0..samples.len()).cycle()) {
        let m = &mut samples[i];
        m.number(k);
        recorder.lane(0).expect("the root").measured(&m.measured).expect("room on the disk");
        recorder.lane(0).expect("the root").smoothed(&m.smoothed).expect("room on the disk");
        recorder.lane(0).expect("the root").torque(&m.torque).expect("room on the disk");
        recorder.lane(0).expect("the root").friction(&m.friction).expect("room on the disk");
        recorder.lane(0).expect("the root").payload(&m.payload).expect("room on the disk");
    }
    let counts = recorder.finish().expect("room on the disk");
    let bytes = std::fs::metadata(path).expect("the file").len();
    let messages = counts.messages.values().sum();
    report(&format!("recorder {name}"), messages, start.elapsed().as_secs_f64(), cpu_s() - cpu, bytes);
    bytes
}

/// The same bytes in 256 KiB writes: what the disk allows.
fn bare(from: &Path, to: &Path) {
    let bytes = std::fs::read(from).expect("the file");
    let (start, cpu) = (Instant::now(), cpu_s());
    let mut file = std::fs::File::create(to).expect("a new file");
    for block in bytes.chunks(256 << 10) {
        file.write_all(block).expect("room on the disk");
    }
    file.sync_all().expect("room on the disk");
    report("bare write of these bytes", SAMPLES * 10, start.elapsed().as_secs_f64(), cpu_s() - cpu, bytes.len() as u64);
}

/// The same messages through the `mcap` crate's writer.
fn peer(from: &Path, to: &Path, name: &str) {
    let bytes = std::fs::read(from).expect("the file");
    let compression = match name {
        "none" => None,
        "lz4" => Some(mcap::Compression::Lz4),
        _ => Some(mcap::Compression::Zstd),
    };
    let messages: Vec<_> =
        mcap::MessageStream::new(&bytes).expect("an MCAP file").map(|m| m.expect("a message")).collect();
    let (start, cpu) = (Instant::now(), cpu_s());
    let file = std::fs::File::create(to).expect("a new file");
    let mut writer = mcap::WriteOptions::new()
        .compression(compression)
        .compression_level(1)
        .compression_threads(1)
        .chunk_size(Some(256 << 10))
        .disable_seeking(true)
        .create(mcap::write::NoSeek::new(file))
        .expect("a writer");
    // By known channel, its fastest way.
    let mut channels = BTreeMap::new();
    for message in &messages {
        let channel = &message.channel;
        let schema = channel.schema.as_ref().expect("every channel has one");
        channels.entry(channel.id).or_insert_with(|| {
            let schema = writer.add_schema(&schema.name, &schema.encoding, &schema.data).expect("room on the disk");
            writer.add_channel(schema, &channel.topic, "cdr", &channel.metadata).expect("room on the disk")
        });
    }
    for message in &messages {
        let header = mcap::records::MessageHeader {
            channel_id: channels[&message.channel.id],
            sequence: message.sequence,
            log_time: message.log_time,
            publish_time: message.publish_time,
        };
        writer.write_to_known_channel(&header, &message.data).expect("room on the disk");
    }
    writer.finish().expect("room on the disk");
    let size = std::fs::metadata(to).expect("the file").len();
    let what = format!("mcap crate {name}");
    report(&what, messages.len() as u64, start.elapsed().as_secs_f64(), cpu_s() - cpu, size);
}
