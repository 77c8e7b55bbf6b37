//! What an installation needs beside the executable: shell completions and man pages, made from the commands themselves.

use crate::{CommandResult, words};
use clap::{Args, Command};
use clap_complete::Shell;
use clap_mangen::Man;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[derive(Args)]
pub struct CompletionsArgs {
    /// Shell.
    shell: Shell,
}

#[derive(Args)]
pub struct ManArgs {
    /// Folder to write the pages to: lacuna.1 and one for every command.
    folder: PathBuf,
}

/// `lacuna completions`.
pub fn completions(args: &CompletionsArgs, mut command: Command) -> CommandResult {
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut command, "lacuna", &mut text);
    words::say(&String::from_utf8_lossy(&text))?;
    Ok(ExitCode::SUCCESS)
}

/// `lacuna man`.
pub fn man(args: &ManArgs, command: Command) -> CommandResult {
    words::folder_for(&args.folder)?;
    let fail = |e| words::cannot_write(&args.folder, &e);
    std::fs::create_dir_all(&args.folder).map_err(fail)?;
    let mut command = command.disable_help_subcommand(true);
    command.build();
    pages(&command, &args.folder).map_err(fail)?;
    Ok(ExitCode::SUCCESS)
}

/// The page of a command and those of its subcommands.
fn pages(command: &Command, folder: &Path) -> std::io::Result<()> {
    for sub in command.get_subcommands().filter(|c| !c.is_hide_set()) {
        pages(sub, folder)?;
    }
    let page = Man::new(command.clone());
    let mut text = Vec::new();
    page.render(&mut text)?;
    // What stands after all help is the exit codes: their section has a name of its own.
    let text = String::from_utf8_lossy(&text).replace(".SH EXTRA", ".SH \"EXIT STATUS\"");
    std::fs::write(folder.join(page.get_filename()), text)
}
