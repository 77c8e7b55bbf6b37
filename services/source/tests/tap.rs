//! The live tap over a veth pair in a network namespace of the test's own: needs the right to make one.

use lacuna_interfaces::RobotFile;
use lacuna_source::tap::Tap;
use nix::ifaddrs::getifaddrs;
use nix::sched::{CloneFlags, unshare};
use nix::sys::socket::{AddressFamily, MsgFlags, SockFlag, SockProtocol, SockType, SockaddrLike, bind, send, socket};
use std::os::fd::AsRawFd;
use std::process::Command;
use std::time::{Duration, Instant};

const ROBOT: &str = "kind = \"serial\"\nname = \"one\"\njoints = [\"a\"]\n[[dh]]\n[drive]\nencoder_bits = 16\n\
    rated_torque_nm = 100\n[ethercat]\ncycle_s = 0.00025\n[[ethercat.axis]]\nposition = 0x1000\ntorque = 0x1004\n";

/// An LRD of six bytes at 0x1000, as it comes back from one slave.
fn frame(k: u32) -> Vec<u8> {
    let mut out = vec![0xFF; 6];
    out.extend([0x12, 0, 0, 0, 0, 1, 0x88, 0xA4]);
    out.extend(((10 + 6 + 2) as u16 | 1 << 12).to_le_bytes());
    out.extend([10, k as u8, 0, 0x10, 0, 0, 6, 0, 0, 0]);
    out.extend(k.to_le_bytes());
    out.extend(((k % 1000) as i16 - 500).to_le_bytes());
    out.extend(1_u16.to_le_bytes());
    out.resize(60, 0);
    out
}

fn ip(arguments: &str) -> bool {
    Command::new("ip").args(arguments.split(' ')).status().is_ok_and(|s| s.success())
}

/// This thread, and those it starts, in a network of their own with a cable between v0 and v1.
fn own_network() -> bool {
    unshare(CloneFlags::CLONE_NEWNET).is_ok()
        && ip("link add v0 type veth peer name v1")
        && ip("link set v0 up")
        && ip("link set v1 up")
}

/// Sends `count` frames at 4 kHz.
fn sender(count: u32) {
    let address = getifaddrs()
        .unwrap()
        .find_map(|a| a.address.filter(|s| a.interface_name == "v1" && s.family() == Some(AddressFamily::Packet)));
    let out = socket(AddressFamily::Packet, SockType::Raw, SockFlag::empty(), SockProtocol::EthAll).unwrap();
    bind(out.as_raw_fd(), &address.unwrap()).unwrap();
    let start = Instant::now();
    for k in 0..count {
        let due = Duration::from_micros(250) * k;
        std::thread::sleep(due.saturating_sub(start.elapsed()));
        send(out.as_raw_fd(), &frame(k), MsgFlags::empty()).unwrap();
    }
}

fn listen(seconds: u32) {
    std::thread::spawn(move || {
        if !own_network() {
            eprintln!("SKIPPED: no right to make a network namespace, or no `ip`");
            return;
        }
        let count = 4000 * seconds;
        let mut tap = Tap::open("v0", &RobotFile::parse(ROBOT).unwrap()).unwrap();
        let sending = std::thread::spawn(move || sender(count));
        let (mut next, mut idle) = (0_u32, 0);
        while next < count && idle < 100 {
            let Some(m) = tap.next_sample().unwrap() else {
                idle += 1;
                continue;
            };
            idle = 0;
            // Nothing lost, nothing doubled, nothing out of order.
            assert_eq!(m.q_rad[0], f64::from(next) * std::f64::consts::TAU / 65536.0, "sample {next}");
            assert!((m.tau_nm[0] - 0.1 * f64::from((next % 1000) as i16 - 500)).abs() < 1e-12);
            next += 1;
            assert_eq!(m.header.seq, u64::from(next));
        }
        sending.join().unwrap();
        assert_eq!((next, tap.dropped()), (count, 0));
        println!("{count} frames at 4 kHz over {seconds} s: {} dropped", tap.dropped());
    })
    .join()
    .unwrap();
}

#[test]
fn every_frame_at_4_khz() {
    listen(3);
}

#[test]
#[ignore = "long: 60 s"]
fn every_frame_at_4_khz_for_a_minute() {
    listen(60);
}

/// A reader that sleeps makes the kernel drop: counted, flagged, and the stream goes on.
#[test]
fn what_the_kernel_drops_is_counted() {
    std::thread::spawn(|| {
        if !own_network() {
            eprintln!("SKIPPED: no right to make a network namespace, or no `ip`");
            return;
        }
        let mut tap = Tap::open("v0", &RobotFile::parse(ROBOT).unwrap()).unwrap();
        tap.shrink_buffer().unwrap();
        sender(3000);
        let (mut seen, mut flagged) = (0_u64, 0);
        let mut sent = 3000;
        loop {
            match tap.next_sample().unwrap() {
                Some(m) => {
                    seen += 1;
                    flagged += u64::from(m.header.has(lacuna_interfaces::flag::GAP));
                }
                // The kernel tells of drops with the next frame.
                None if sent == 3000 => {
                    sender(1);
                    sent += 1;
                }
                None => break,
            }
        }
        assert!(tap.dropped() > 0 && seen < 3001, "{seen} seen, {} dropped", tap.dropped());
        assert!(seen + tap.dropped() >= sent, "{seen} seen, {} dropped", tap.dropped());
        assert!(flagged > 0);
    })
    .join()
    .unwrap();
}

#[test]
fn what_is_missing_is_said() {
    let robot = RobotFile::parse(ROBOT).unwrap();
    let e = Tap::open("nosuch0", &robot).unwrap_err().to_string();
    assert!(e.contains("no network interface \"nosuch0\""), "{e}");
    let plain = RobotFile::parse(&ROBOT[..ROBOT.find("[ethercat]").unwrap()]).unwrap();
    let e = Tap::open("lo", &plain).unwrap_err().to_string();
    assert!(e.contains("no [ethercat]"), "{e}");
}
