//! `cargo bench -p lacuna-benches`: time per sample of every stage, as `lacuna bench stages` prints it.

fn main() -> Result<(), lacuna_benches::BenchError> {
    for row in lacuna_benches::stages::run(&mut |_| ())? {
        println!("{:<52} {:>9.1} ns/sample  {}", row.what, row.ns, row.note);
    }
    Ok(())
}
