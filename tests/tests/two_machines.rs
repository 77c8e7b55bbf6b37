//! A graph on two machines: two network namespaces with a cable between them, the tunnel's real executable, real loss
//! counted at the far end; and the words for what a link cannot do.

use lacuna_tests::{Bench, Messages, error_line, messages, report, tool, workspace};
use serde_json::Value;
use std::process::{Command, Output, Stdio};

fn up(bench: &Bench, graph: &str, sets: &[&str]) -> Output {
    let graph = workspace().join(graph).display().to_string();
    let args: Vec<&str> = ["up", &graph, "--quiet"].into_iter().chain(sets.iter().flat_map(|s| ["--set", s])).collect();
    bench.lacuna(&args)
}

#[test]
fn what_a_link_cannot_do_is_said_before_anything_runs() {
    let bench = Bench::with_motion(0.5);
    let robot = ["recording=run.csv", "robot=robot.toml", "out=raw.mcap"];
    let desk = ["robot=robot.toml", "out=run.mcap"];
    let refused = |out: &Output, words: &[&str]| {
        let line = error_line(out);
        assert_eq!(out.status.code(), Some(2), "{line}");
        assert!(words.iter().all(|w| line.contains(w)), "{line}");
    };
    refused(&up(&bench, "launch/two_machines/desk.toml", &desk), &["neither listen nor connect"]);
    let bad = [&robot[..], &["listen=0.0.0.0:7447"]].concat();
    refused(&up(&bench, "launch/two_machines/robot.toml", &bad), &["listen", "tcp/ADDRESS:PORT"]);
    let text = std::fs::read_to_string(workspace().join("launch/two_machines/robot.toml")).expect("graph");
    let replay = text.replace("mode = \"live\"", "mode = \"replay\"").replace("restart = \"on-failure\"\n", "");
    let graph = bench.write("replay.toml", &replay);
    refused(&up(&bench, &graph.display().to_string(), &robot), &["link", "replay", "move the recording"]);
    // A tunnel that is not installed: said by its name, and where to look.
    let text = text.replace("restart = \"on-failure\"\n", "");
    let graph = bench.write("once.toml", &text);
    let absent = [&robot[..], &["tunnel=/no/such/tunnel", "listen=tcp/127.0.0.1:17440"]].concat();
    let out = up(&bench, &graph.display().to_string(), &absent);
    let line = error_line(&out);
    assert_eq!(out.status.code(), Some(1), "{line}");
    assert!(line.contains("/no/such/tunnel") && line.contains("TWO_MACHINES.md"), "{line}");
}

/// Two network namespaces with a cable between them; gone when dropped.
struct Cable {
    names: [String; 2],
}

impl Cable {
    const ADDRESSES: [&str; 2] = ["10.77.31.1", "10.77.31.2"];

    /// `None` where this process may not make any.
    fn lay() -> Option<Self> {
        let id = std::process::id();
        let cable = Self { names: [format!("lacuna-a-{id}"), format!("lacuna-b-{id}")] };
        let [a, b] = &cable.names;
        let ip = |args: &[&str]| Command::new("ip").args(args).output().is_ok_and(|o| o.status.success());
        let made = ip(&["netns", "add", a])
            && ip(&["netns", "add", b])
            && ip(&["link", "add", "veth-a", "netns", a, "type", "veth", "peer", "name", "veth-b", "netns", b]);
        let up = |name: &str, device: &str, address: &str| {
            ip(&["-n", name, "addr", "add", &format!("{address}/24"), "dev", device])
                && ip(&["-n", name, "link", "set", device, "up"])
                && ip(&["-n", name, "link", "set", "lo", "up"])
        };
        let done = made && up(a, "veth-a", Self::ADDRESSES[0]) && up(b, "veth-b", Self::ADDRESSES[1]);
        done.then_some(cable)
    }

    /// `lacuna up` at one end.
    fn up(&self, end: usize, bench: &Bench, graph: &str, sets: &[String]) -> std::process::Child {
        Command::new("ip")
            .args(["netns", "exec", &self.names[end]])
            .arg(lacuna_tests::bin("lacuna"))
            .arg("up")
            .arg(workspace().join(graph))
            .arg("--json")
            .args(sets.iter().flat_map(|s| ["--set", s.as_str()]))
            .current_dir(bench.path())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("ip starts")
    }
}

impl Drop for Cable {
    fn drop(&mut self) {
        for name in &self.names {
            let _ = Command::new("ip").args(["netns", "del", name]).output();
        }
    }
}

fn count(value: &Value) -> u64 {
    value.as_u64().unwrap_or_else(|| panic!("expected a count, found {value}"))
}

#[test]
#[ignore = "long: two network namespaces and the zenoh tunnel"]
fn a_stream_crosses_and_what_is_lost_is_counted() {
    let name = "a_stream_crosses_and_what_is_lost_is_counted";
    let Some(tunnel) = tool("iox2-link-tunnel-zenoh") else {
        eprintln!("SKIPPED: {name}: no iox2-link-tunnel-zenoh");
        return;
    };
    let Some(cable) = Cable::lay() else {
        eprintln!("SKIPPED: {name}: no network namespaces (needs root and ip)");
        return;
    };
    let tunnel = format!("tunnel={}", tunnel.display());
    // Both namespaces have both clocks of this machine: stamps must come across by either.
    for (khz, seconds, clocks) in [(1, 6.0, "one"), (1, 6.0, "synchronised"), (4, 24.0, "synchronised")] {
        let bench = Bench::with_motion(seconds);
        let common = ["robot=robot.toml".to_owned(), format!("clocks={clocks}"), tunnel.clone()];
        let port = 17440 + khz + if clocks == "one" { 10 } else { 0 };
        let desk = [
            "model=model.toml".to_owned(),
            "out=desk.mcap".to_owned(),
            format!("connect=tcp/{}:{port}", Cable::ADDRESSES[0]),
        ];
        let desk = cable.up(1, &bench, "launch/two_machines/desk.toml", &[&common[..], &desk].concat());
        let robot = [
            "recording=run.csv".to_owned(),
            "out=raw.mcap".to_owned(),
            format!("rate={khz}.0"),
            format!("listen=tcp/{}:{port}", Cable::ADDRESSES[0]),
        ];
        let robot = cable.up(0, &bench, "launch/two_machines/robot.toml", &[&common[..], &robot].concat());
        let robot = report(&robot.wait_with_output().expect("the robot's half ends"));
        let done = desk.wait_with_output().expect("the desk's half ends");
        let desk = report(&done);

        let sent = count(&robot["samples"]);
        let link = &desk["nodes"]["link"];
        let (came, missing) = (count(&link["published"]), count(&link["missing"]));
        let before = count(&link["details"]["before_joining"]);
        assert_eq!(came + missing + before, sent, "every sample came or is counted: {link}");
        assert!(came > sent / 2, "only {came} of {sent} came");
        assert_eq!(done.status.code(), Some(if count(&desk["lost"]) > 0 { 3 } else { 0 }));
        assert!(count(&desk["lost"]) >= missing);
        same_numbers(&messages(&bench.path().join("raw.mcap")), &messages(&bench.path().join("desk.mcap")), came);
        // source → link at the robot → link at the desk: the last hop is the link's.
        let hops = link["latency"].as_array().expect("latency");
        let across = hops.iter().find(|hop| hop["hop"] == "1→here").unwrap_or_else(|| panic!("no hop: {link}"));
        assert_eq!(count(&across["count"]), came);
        assert_eq!(link["details"]["stamped_later_than_they_came"], 0, "{link}");
        let us = |key: &str| across[key].as_f64().unwrap_or_else(|| panic!("{key}: {across}"));
        let [p50, p99, max] = ["p50_us", "p99_us", "max_us"].map(us);
        assert!(0.0 < p50 && p50 <= p99 && p99 <= max, "{across}");
        eprintln!(
            "{khz} kHz, clocks {clocks}: {sent} sent, {came} came, {missing} lost, {before} before joining; across the \
             link p50 {:.2} ms, p99 {:.2} ms, at most {:.1} ms",
            p50 / 1e3,
            p99 / 1e3,
            max / 1e3
        );
    }
}

/// Every measured sample at the desk is one that the robot recorded, byte for byte.
fn same_numbers(raw: &Messages, desk: &Messages, came: u64) {
    let robot: std::collections::BTreeMap<u64, &[u8]> =
        raw["/measured"].iter().map(|(t, d)| (*t, d.as_slice())).collect();
    assert_eq!(desk["/measured"].len() as u64, came);
    for (stamp, data) in &desk["/measured"] {
        assert_eq!(robot.get(stamp), Some(&data.as_slice()), "at {stamp}");
    }
}
