//! Prints the catalogue of effects in Markdown: `cargo run -p lacuna-physics --example effects > docs/EFFECTS.md`.

fn main() {
    print!("{}", lacuna_physics::effects::markdown());
}
