//! Writes example reports and pictures made of invented data, to look at:
//! `cargo run -p lacuna-report --example gallery -- OUT_DIR`.

#[path = "../tests/gallery/mod.rs"]
mod gallery;

use lacuna_report::{OverlayPicture, diagnosis_report, identification_report, overlay_svg, table_picture};
use std::path::Path;

fn main() -> std::io::Result<()> {
    let Some(dir) = std::env::args().nth(1) else {
        return Err(std::io::Error::other("usage: gallery OUT_DIR"));
    };
    let dir = Path::new(&dir);
    std::fs::create_dir_all(dir)?;
    let trace = gallery::trace("traj_03.csv", 0, &["M_KH", "M_Id", "M_Id+F", "pooled fit"]);
    let mut three = trace.clone();
    three.joints.iter_mut().for_each(|j| j.models.truncate(3));
    let picture = OverlayPicture {
        title: "Measured and modelled torque, invented example",
        torque_unit: "Nm",
        trace: &three,
        window_s: Some((0.0, 8.0)),
    };
    std::fs::write(dir.join("identification.html"), identification_report(&gallery::identification()))?;
    std::fs::write(dir.join("diagnosis.html"), diagnosis_report(&gallery::diagnosis()))?;
    std::fs::write(dir.join("overlay.svg"), overlay_svg(&picture))?;
    std::fs::write(dir.join("table.svg"), table_picture(&gallery::table_1(&trace), "Nm"))
}
