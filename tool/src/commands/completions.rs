//! `haptic completions`: prints shell completions, or the manual.

use super::help;
use clap::builder::{Resettable, StyledStr};
use clap_complete::Shell;
use clap_mangen::Man;
use clap_mangen::roff::{Roff, roman};
use haptic_host::error::{Failure, print};
use haptic_host::output::{self, Overwrite};
use std::path::PathBuf;

/// Print shell completions, or the manual
///
/// --man alone prints the page of `haptic`; with a directory it writes that page and one page for every command there,
/// and replaces the pages of another version.
#[derive(clap::Args)]
pub struct Args {
    /// Shell for the completions
    #[arg(required_unless_present = "man")]
    shell: Option<Shell>,
    /// Print the manual instead, or write all of its pages into this directory
    #[arg(long, value_name = "DIRECTORY", num_args = 0..=1, conflicts_with = "shell")]
    man: Option<Option<PathBuf>>,
}

pub fn run(args: Args) -> Result<(), Failure> {
    if let Some(shell) = args.shell {
        let mut document = Vec::new();
        clap_complete::generate(shell, &mut help::command(), "haptic", &mut document);
        return print(&String::from_utf8_lossy(&document));
    }
    let mut haptic = help::command();
    haptic.build();
    let Some(folder) = args.man.flatten() else {
        return print(&manual_page(&haptic, "haptic")?);
    };
    std::fs::create_dir_all(&folder).map_err(|error| output::write_failure(&folder, &error))?;
    let write = |name: &str, command: &clap::Command| {
        let text = manual_page(command, name)?;
        output::write(&folder.join(format!("{name}.1")), text.as_bytes(), Overwrite::Replace)
    };
    let mut pending = vec![("haptic".to_string(), &haptic)];
    while let Some((name, command)) = pending.pop() {
        write(&name, command)?;
        let subs = command.get_subcommands().filter(|sub| sub.get_name() != "help" && !sub.is_hide_set());
        pending.extend(subs.map(|sub| (format!("{name}-{}", sub.get_name()), sub)));
    }
    Ok(())
}

/// Renders a manual page, with the sections that clap does not write: exit codes, examples, files.
fn manual_page(command: &clap::Command, name: &str) -> Result<String, Failure> {
    let words = command.get_bin_name().unwrap_or_default();
    let examples = help::examples(words.strip_prefix("haptic ").unwrap_or_default());
    // Removes the examples from the description, because they have their own section.
    let man = Man::new(command.clone().after_help(Resettable::<StyledStr>::Reset).display_name(name));
    let mut text = Vec::new();
    man.render(&mut text).map_err(|error| Failure::impossible(format!("cannot render the manual page: {error}")))?;
    let mut roff = Roff::new();
    let mut section = |heading: &str, lines: &[&str]| {
        roff.control("SH", [heading]);
        for line in lines {
            roff.text([roman(*line)]);
            roff.control("br", []);
        }
    };
    section("EXIT STATUS", &["0: done", "1: it could not be done", "2: the command or a file is wrong"]);
    if !examples.is_empty() {
        section("EXAMPLES", examples);
    }
    if name == "haptic" {
        section("EXAMPLES", &["haptic demo", "haptic sim", "haptic info --port PORT"]);
    }
    section(
        "FILES",
        &[
            "DEVICE.toml: a device; docs/files.md has every key, devices/ examples",
            "SCENE.toml: walls, springs and fields; devices/scenes/ has examples",
            "FILE.csv: a recording; docs/telemetry.md has every field",
        ],
    );
    Ok(String::from_utf8_lossy(&text).into_owned() + &roff.to_roff())
}
