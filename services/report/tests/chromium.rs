//! Opens the reports in headless Chromium, if there is one: nothing logged, nothing requested, every chart
//! drawn, zoom by mouse and reset by key. The checks are in `tests/oracles/screenshot_report.py`.

mod gallery;

use lacuna_report::{diagnosis_report, identification_report};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn on_path(program: &str) -> bool {
    std::env::var_os("PATH").is_some_and(|p| std::env::split_paths(&p).any(|dir| dir.join(program).is_file()))
}

fn script() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/oracles/screenshot_report.py")
}

fn check(views: &str, reports: &[PathBuf]) -> Output {
    Command::new("python3").arg(script()).args(["--views", views]).args(reports).output().expect("python3 starts")
}

#[test]
fn reports_are_drawn_without_errors_or_requests() {
    if !(on_path("chromium") && on_path("python3")) {
        eprintln!("SKIPPED: chromium or python3 is not on PATH");
        return;
    }
    let dir = Path::new(env!("CARGO_TARGET_TMPDIR")).join("chromium");
    std::fs::create_dir_all(&dir).expect("a directory for the reports");
    let write = |name: &str, html: &str| {
        let path = dir.join(name);
        std::fs::write(&path, html).expect("the report is written");
        path
    };
    let mut hostile = gallery::diagnosis();
    for joint in hostile.traces.iter_mut().flat_map(|t| &mut t.joints) {
        joint.joint.push_str("</script><img src=http://127.0.0.1:9/x onerror=alert(1)>");
    }
    let good = [
        write("identification.html", &identification_report(&gallery::identification())),
        write("diagnosis.html", &diagnosis_report(&gallery::diagnosis())),
        write("hostile.html", &diagnosis_report(&hostile)),
    ];
    let output = check("light,dark,narrow", &good);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));

    // The check itself has to fail on what it is there to find.
    let html = diagnosis_report(&gallery::diagnosis());
    let unprotected = html.replace("http-equiv=\"Content-Security-Policy\"", "name=\"none\"");
    let broken = [
        (
            "request",
            unprotected.replace("</main>", "<img src=\"http://127.0.0.1:9/x.png\"></main>"),
            "request: http://127.0.0.1:9/x.png",
        ),
        ("error", unprotected.replace("</body>", "<script>console.error('broken')</script></body>"), "console error"),
        ("policy", html.replace("</body>", "<script>window.ran = 1</script></body>"), "Content Security Policy"),
        ("empty", html.replace("Z0;", "").replace("\"values\":\"", "\"values\":\"AADAfw=="), "is empty"),
    ];
    let files: Vec<PathBuf> =
        broken.iter().map(|(name, page, _)| write(&format!("broken_{name}.html"), page)).collect();
    let output = check("light", &files);
    assert!(!output.status.success());
    let words = String::from_utf8_lossy(&output.stderr);
    for (name, _, expected) in broken {
        let file = format!("broken_{name}.html");
        assert!(words.lines().any(|l| l.starts_with(&file) && l.contains(expected)), "{name}: {words}");
    }
}
