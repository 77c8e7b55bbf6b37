//! The installations: the Debian package is built, looked into, laid out in a scratch root and run from there; cargo
//! installs the command line and a stage into a folder of its own.

use lacuna_tests::{Bench, bin_dir, report, tool, workspace};
use std::path::Path;
use std::process::{Command, Output};

fn run(command: &mut Command) -> Output {
    let out = command.output().unwrap_or_else(|e| panic!("{command:?}: {e}"));
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    assert!(out.status.success(), "{command:?}: {}{}", text(&out.stdout), text(&out.stderr));
    out
}

/// `lacuna up` from an installation: its own executables alone, its own launch files.
fn replay(lacuna: &Path, launch: &Path, bench: &Bench) {
    let sets = ["recording=run.csv", "robot=robot.toml", "model=model.toml", "out=run.mcap"];
    let mut up = Command::new(lacuna);
    up.arg("up").arg(launch.join("replay.toml")).arg("--json").args(sets.iter().flat_map(|s| ["--set", s]));
    let report = report(&run(up.env("PATH", "/usr/bin:/bin").current_dir(bench.path())));
    assert_eq!(report["lost"], 0);
    assert!(report["samples"].as_u64() > Some(900));
}

#[test]
#[ignore = "long: builds a Debian package (needs cargo-deb and dpkg-deb)"]
fn the_debian_package_holds_all_and_runs() {
    let (Some(cargo_deb), Some(dpkg)) = (tool("cargo-deb"), tool("dpkg-deb")) else {
        eprintln!("SKIPPED: the_debian_package_holds_all_and_runs: no cargo-deb or no dpkg-deb");
        return;
    };
    let bench = Bench::with_motion(1.0);
    let beside = cargo_deb.parent().expect("a folder").display().to_string();
    let path = format!("{beside}:{}", std::env::var("PATH").unwrap_or_default());
    let target = bin_dir().parent().expect("a target folder").to_path_buf();
    let mut build = Command::new(workspace().join("packaging/deb.sh"));
    build.arg("--no-build").arg(bench.path()).env("PATH", path).env("CARGO_TARGET_DIR", target);
    run(&mut build);
    let entries = std::fs::read_dir(bench.path()).expect("folder").flatten().map(|e| e.path());
    let package = entries.into_iter().find(|p| p.extension().is_some_and(|e| e == "deb")).expect("a package");

    let listed = run(Command::new(&dpkg).arg("--contents").arg(&package)).stdout;
    let listed = String::from_utf8_lossy(&listed).into_owned();
    for name in ["source", "smoother", "torque", "friction", "payload", "monitor", "recorder", "live", "link"] {
        assert!(listed.contains(&format!("./usr/bin/lacuna-{name}\n")), "{name}: {listed}");
    }
    for file in [
        "usr/lib/systemd/system/lacuna@.service",
        "usr/lib/systemd/system/lacuna.target",
        "usr/lib/sysusers.d/lacuna.conf",
        "usr/share/man/man1/lacuna-up.1.gz",
        "usr/share/bash-completion/completions/lacuna",
        "usr/share/lacuna/launch/live.toml",
        "usr/share/lacuna/launch/layouts/foxglove.json",
        "usr/share/lacuna/launch/python/lacuna_messages.py",
        "usr/share/doc/lacuna/copyright",
    ] {
        assert!(listed.contains(&format!("./{file}\n")), "{file}: {listed}");
    }
    // Nothing of a package may be writable for others.
    assert!(!listed.lines().any(|l| l.chars().nth(8) == Some('w') && !l.starts_with('l')), "{listed}");

    let root = bench.path().join("root");
    run(Command::new(&dpkg).arg("-x").arg(&package).arg(&root));
    let version = run(Command::new(root.join("usr/bin/lacuna")).arg("--version")).stdout;
    assert!(String::from_utf8_lossy(&version).starts_with("lacuna "));
    replay(&root.join("usr/bin/lacuna"), &root.join("usr/share/lacuna/launch"), &bench);
    units(&root);
}

/// systemd takes the units as they lie in `root`.
fn units(root: &Path) {
    let Some(analyze) = tool("systemd-analyze") else {
        eprintln!("SKIPPED: systemd-analyze verify: not installed");
        return;
    };
    // Read as they will be installed, except that the executables lie below `root`.
    let folder = root.join("units");
    std::fs::create_dir_all(&folder).expect("folder");
    let from = root.join("usr/lib/systemd/system");
    for (name, instance) in [("lacuna@.service", "lacuna@line1.service"), ("lacuna.target", "lacuna.target")] {
        let text = std::fs::read_to_string(from.join(name)).expect("unit");
        let own = text.replace("/usr/bin/lacuna", &root.join("usr/bin/lacuna").display().to_string());
        // Documentation that is not installed here is not the unit's fault.
        let own: String =
            own.lines().filter(|l| !l.starts_with("Documentation=")).map(|l| l.to_owned() + "\n").collect();
        std::fs::write(folder.join(instance), own).expect("unit");
    }
    let out = Command::new(&analyze)
        .args(["verify", "lacuna@line1.service", "lacuna.target"])
        .current_dir(&folder)
        .env("SYSTEMD_UNIT_PATH", format!("{}:", folder.display()))
        .output()
        .expect("systemd-analyze");
    let said = String::from_utf8_lossy(&out.stderr).into_owned();
    let about: Vec<&str> = said.lines().filter(|l| l.contains("lacuna")).collect();
    assert!(about.is_empty(), "{about:?}");
    let out = Command::new(&analyze)
        .args(["security", "--offline=yes", "lacuna@line1.service"])
        .current_dir(&folder)
        .env("SYSTEMD_UNIT_PATH", format!("{}:", folder.display()))
        .output()
        .expect("systemd-analyze");
    let said = String::from_utf8_lossy(&out.stdout).into_owned();
    if let Some(line) = said.lines().find(|l| l.contains("Overall exposure")) {
        eprintln!("{}", line.trim());
    }
}

#[test]
#[ignore = "long: cargo install compiles the command line anew"]
fn cargo_installs_the_command_line_and_names_a_missing_stage() {
    let bench = Bench::with_motion(1.0);
    let root = bench.path().join("root");
    let target = bin_dir().parent().expect("a target folder").to_path_buf();
    let install = |service: &str| {
        let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
        cargo.args(["install", "--locked", "--path"]).arg(workspace().join("services").join(service));
        cargo.arg("--root").arg(&root).env("CARGO_TARGET_DIR", &target);
        run(&mut cargo);
    };
    install("lacuna");
    let lacuna = root.join("bin/lacuna");
    let graph = workspace().join("launch/replay.toml");
    let mut up = Command::new(&lacuna);
    up.arg("up").arg(&graph).args(["--set", "recording=run.csv", "--set", "robot=robot.toml", "--dry-run"]);
    let out = up.env("PATH", "/usr/bin:/bin").current_dir(bench.path()).output().expect("lacuna starts");
    let line = String::from_utf8_lossy(&out.stderr).into_owned();
    assert_eq!(out.status.code(), Some(2), "{line}");
    assert!(line.contains("lacuna-source") && line.contains("docs/INSTALL.md"), "{line}");
    for stage in ["source", "smoother", "torque", "friction", "payload", "monitor", "recorder"] {
        install(stage);
    }
    replay(&lacuna, &workspace().join("launch"), &bench);
}
