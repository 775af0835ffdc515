//! `haptic completions`: shell completions, and the manual page.

use crate::cli;
use clap_complete::Shell;
use haptic::error::{Failure, print};

/// Print shell completions, or the manual page
///
/// bash: haptic completions bash > ~/.local/share/bash-completion/completions/haptic
/// man: haptic completions --man > haptic.1
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Args {
    /// For which shell
    #[arg(required_unless_present = "man")]
    shell: Option<Shell>,
    /// Print the manual page instead
    #[arg(long, conflicts_with = "shell")]
    man: bool,
}

/// Writes the script or page to standard output.
pub fn run(args: Args) -> Result<(), Failure> {
    let mut document = Vec::new();
    match args.shell {
        Some(shell) => clap_complete::generate(shell, &mut cli::command(), "haptic", &mut document),
        None => clap_mangen::Man::new(cli::command())
            .render(&mut document)
            .map_err(|error| Failure::impossible(format!("the manual page cannot be made: {error}")))?,
    }
    print(&String::from_utf8_lossy(&document))
}
