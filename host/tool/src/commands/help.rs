//! The help page: its commands under headings, and lines to type.

use super::{Command, HEADINGS, list_of_fields};
use clap::{CommandFactory, Parser};

/// Configure, watch, simulate and analyse haptic-bridge boards: motor drivers that render hard walls on a device
/// whose inertia they know.
///
/// Devices are described in TOML files (see devices/), walls in scene files (see devices/scenes/). Units are SI
/// everywhere (metres, radians, newtons, kilograms) but in `haptic measure-range --pull MM`.
#[derive(Parser)]
#[command(name = "haptic", version, max_term_width = 110)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// The command with its help page laid out.
pub fn command() -> clap::Command {
    let command = Cli::command();
    let width = HEADINGS.iter().flat_map(|(_, names)| *names).map(|name| name.len()).max().unwrap_or(0) + 2;
    let mut listing = String::new();
    for (heading, names) in HEADINGS {
        listing.push_str(&format!("{heading}:\n"));
        for name in *names {
            // Modules are written with underscores, commands with hyphens.
            let name = name.replace('_', "-");
            let about = command.find_subcommand(&name).and_then(|found| found.get_about()).map(ToString::to_string);
            listing.push_str(&format!("  {name:width$}{}\n", about.unwrap_or_default()));
        }
        listing.push('\n');
    }
    let template = format!(
        "{{about-with-newline}}\n{{usage-heading}} {{usage}}\n\n{listing}{START}\n\
         `haptic help COMMAND` explains one command; `haptic --version` prints the version.\n\
         Exit codes: 0 done, 1 it could not be done, 2 the command or a file is wrong."
    );
    command.help_template(template).mut_subcommands(|sub| {
        let examples = examples(sub.get_name());
        let mut more = String::new();
        if sub.get_name() == "stream" {
            more.push_str(&list_of_fields());
            more.push('\n');
        }
        if !examples.is_empty() {
            more.push_str(&format!("Examples:\n  {}", examples.join("\n  ")));
        }
        // A number may be negative: it is then refused for what it is, not taken for an option.
        let sub = sub.mut_args(|arg| {
            let valued = arg.get_action().takes_values() && !arg.is_positional();
            if valued && !arg.is_allow_hyphen_values_set() { arg.allow_negative_numbers(true) } else { arg }
        });
        if more.is_empty() { sub } else { sub.after_help(more) }
    })
}

/// Where a newcomer begins.
const START: &str = "Start here, without hardware:
  haptic demo                     what the feed-forward buys, in seconds
  haptic view --port sim          a device, a wall and a hand to lead, in the browser
  haptic sim                      a simulated board; it prints the PORT for the commands \"With a board\"
  haptic info --port PORT
";

/// Lines to type, for the help of a command and its page of the manual. Tests read
/// every one, see that the files they name ship, and type those that need no board and little time.
pub fn examples(command: &str) -> &'static [&'static str] {
    match command {
        "new" => &["haptic new five-bar -o mine.toml", "haptic new scene --device mine.toml -o wall.toml"],
        "check" => &["haptic check devices/haply-2diy.toml devices/scenes/haply-2diy/wall-soft.toml"],
        "model" => &["haptic model devices/coupled-five-bar.toml --q 2.6,1.75 --normal 0.94,-0.34 --force 1"],
        "map" => &["haptic map devices/coupled-five-bar.toml --normal 0,1 --png map.png"],
        "plan" => &["haptic plan devices/haply-2diy.toml devices/scenes/haply-2diy/wall-soft.toml"],
        "precompute" => &["haptic precompute devices/haply-2diy.toml --kind frozen --box 1.8,2.2,0.9,1.3"],
        "range" => &["haptic range devices/coupled-five-bar.toml --normal 0.6,0.8 --rate 20000 --cutoff 500"],
        "estimators" => &["haptic estimators devices/coupled-five-bar.toml --q 2.6,1.75 --normal 0.6,0.8"],
        "tune" => &[
            "haptic tune devices/haply-2diy.toml --normal 0,1",
            "haptic tune devices/haply-2diy.toml --scene devices/scenes/haply-2diy/wall-stiff.toml --out tuned.toml",
        ],
        "design" => &["haptic design devices/serial-3r.toml --normal 0.42,-0.91 --svg design.svg"],
        "report" => {
            &["haptic report devices/haply-2diy.toml devices/scenes/haply-2diy/wall-stiff.toml --out haply.html"]
        }
        "sim" => &["haptic sim", "haptic sim devices/haply-2diy.toml --tcp 7710 --hand loop"],
        "info" => &["haptic info --port sim", "haptic info --port /dev/ttyACM0 --json"],
        "device" => &["haptic device devices/haply-2diy.toml"],
        "scene" => &["haptic scene devices/scenes/haply-2diy/wall-soft.toml"],
        "gains" => &["haptic gains --stiffness 800 --damping 2", "haptic gains --wall 1 --feed-forward off"],
        "rules" => &["haptic rules --torque 0.1,0.1 --host disarm", "haptic rules --json"],
        "stream" => &[
            "haptic stream",
            "haptic stream --csv contact.csv --seconds 10",
            "haptic stream --csv - --fields q,force,rendered --rate 5000 | head -n 100",
        ],
        "record" => &["haptic record contact.mcap", "haptic record contact.csv --rate 1000 --seconds 10"],
        "plot" => &[
            "haptic plot contact.mcap --svg contact.svg --width 85",
            "haptic plot contact.csv --show force --png force.png",
        ],
        "replay" => &["haptic replay contact.mcap"],
        "serve" => &["haptic serve --haply --port sim"],
        "view" => &["haptic view --port sim", "haptic view devices/haply-2diy.toml --port sim"],
        "monitor" => &["haptic monitor --port sim", "haptic monitor devices/haply-2diy.toml"],
        "measure-range" => {
            &["haptic measure-range devices/coupled-five-bar.toml --port sim --normal 0.6,0.8 --rate 1000 --cutoff 20"]
        }
        "backup" => &["haptic backup board.json"],
        "restore" => &["haptic restore board.json"],
        "completions" => &[
            "haptic completions bash > ~/.local/share/bash-completion/completions/haptic",
            "haptic completions --man ~/.local/share/man/man1",
        ],
        _ => &[],
    }
}
