//! The help page: commands under headings, and examples.

use super::{Command, HEADINGS, UNLISTED_HEADING, list_of_fields};
use clap::{CommandFactory, Parser};

/// Configure, watch, simulate and analyse haptic-bridge boards: motor drivers that render hard walls on a device
/// whose inertia they know.
///
/// Devices are described in TOML files (see devices/), walls in scene files (see devices/scenes/). Units are SI
/// (metres, radians, newtons, kilograms) except in `haptic measure-range --pull MM`.
#[derive(Parser)]
#[command(name = "haptic", version, max_term_width = 110)]
pub struct Cli {
    #[command(subcommand)]
    pub command: Command,
}

pub fn command() -> clap::Command {
    let command = Cli::command();
    let listed = || HEADINGS.iter().filter(|(heading, _)| *heading != UNLISTED_HEADING);
    let width = listed().flat_map(|(_, names)| *names).map(|name| name.len()).max().unwrap_or(0) + 2;
    let hidden: Vec<&str> = HEADINGS
        .iter()
        .filter(|(heading, _)| *heading == UNLISTED_HEADING)
        .flat_map(|(_, names)| *names)
        .copied()
        .collect();
    let mut listing = String::new();
    for (heading, names) in listed() {
        listing.push_str(&format!("{heading}:\n"));
        for name in *names {
            // Converts the name of a module to the name of its command.
            let name = name.replace('_', "-");
            let about = command.find_subcommand(&name).and_then(|found| found.get_about()).map(ToString::to_string);
            listing.push_str(&format!("  {name:width$}{}\n", about.unwrap_or_default()));
        }
        listing.push('\n');
    }
    let template = format!(
        "{{about-with-newline}}\n{{usage-heading}} {{usage}}\n\n{listing}{FIRST_COMMANDS}\n\
         `haptic help COMMAND` explains one command; `haptic --version` prints the version.\n\
         Not listed, each with its own page: {}.\n\
         Exit codes: 0 done, 1 it could not be done, 2 the command or a file is wrong, 3 what was compared differs.",
        hidden.join(", ")
    );
    command.help_template(template).mut_subcommands(|sub| {
        let hide = hidden.contains(&sub.get_name());
        add_examples(sub, "").hide(hide)
    })
}

/// Appends examples to the help of a command and of its subcommands; `above` holds the words before the command.
fn add_examples(command: clap::Command, above: &str) -> clap::Command {
    let words = format!("{above}{}", command.get_name());
    let mut more = String::new();
    if ["stream", "record"].contains(&words.as_str()) {
        more.push_str(&list_of_fields());
        more.push('\n');
    }
    let examples = examples(&words);
    if !examples.is_empty() {
        more.push_str(&format!("Examples:\n  {}", examples.join("\n  ")));
    }
    // Accepts negative numbers as values, so that the error is about the value and not about an unknown option.
    let command = command.mut_args(|arg| {
        let valued = arg.get_action().takes_values() && !arg.is_positional();
        if valued && !arg.is_allow_hyphen_values_set() { arg.allow_negative_numbers(true) } else { arg }
    });
    let command = command.mut_subcommands(|sub| add_examples(sub, &format!("{words} ")));
    if more.is_empty() { command } else { command.after_help(more) }
}

/// First commands for a new user.
const FIRST_COMMANDS: &str = "Start here, without hardware:
  haptic demo                     the benefit of the feed-forward, in seconds
  haptic view --port sim          a device, a wall and a hand that you move, in the browser
  haptic sim                      a simulated board; it prints the PORT for the commands \"With a board\"
  haptic info --port PORT
";

/// Returns examples for a command's help and manual page. Tests parse every example, check that the files in it are
/// part of the project, and run the examples that need no board and little time.
pub fn examples(words: &str) -> &'static [&'static str] {
    match words {
        "new" => &["haptic new five-bar -o mine.toml", "haptic new scene --device mine.toml -o wall.toml"],
        "check" => &["haptic check devices/haply-2diy.toml devices/scenes/haply-2diy/wall-soft.toml"],
        "model" => &["haptic model devices/coupled-five-bar.toml --q 2.6,1.75 --normal 0.94,-0.34 --force 1"],
        "map" => &["haptic map devices/coupled-five-bar.toml --normal 0,1 --png map.png"],
        "range" => &["haptic range devices/coupled-five-bar.toml --normal 0.6,0.8 --rate 20000 --cutoff 500"],
        "tune estimators" => &["haptic tune estimators devices/coupled-five-bar.toml --q 2.6,1.75 --normal 0.6,0.8"],
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
        "device" => &["haptic device devices/haply-2diy.toml", "haptic device --read devices/haply-2diy.toml"],
        "scene" => &[
            "haptic scene devices/scenes/haply-2diy/wall-soft.toml",
            "haptic scene --read devices/scenes/haply-2diy/wall-soft.toml",
        ],
        "gains" => &["haptic gains --stiffness 800 --damping 2", "haptic gains --wall 1 --feed-forward off"],
        "rules" => &["haptic rules --torque 0.1,0.1 --host disarm", "haptic rules --json"],
        "stream" => &["haptic stream", "haptic stream --fields counts --seconds 10"],
        "record" => &[
            "haptic record contact.mcap",
            "haptic record contact.csv --rate 1000 --seconds 10",
            "haptic record - --fields q,force,rendered --rate 5000 | head -n 100",
        ],
        "plot" => &[
            "haptic plot contact.mcap --svg contact.svg --width 85",
            "haptic plot contact.csv --show force --png force.png",
        ],
        "cogging" => &["haptic cogging devices/gimbal-paddle.toml --joint 0 --svg cogging.svg"],
        "replay" => &["haptic replay contact.mcap"],
        "serve" => &["haptic serve --haply --port sim"],
        "view" => &["haptic view --port sim", "haptic view devices/haply-2diy.toml --port sim"],
        "measure-range" => {
            &["haptic measure-range devices/coupled-five-bar.toml --port sim --normal 0.6,0.8 --rate 1000 --cutoff 20"]
        }
        "faults" => &["haptic faults", "haptic faults --clear"],
        "board" => &["haptic board list", "haptic board save"],
        "flash" => &["haptic flash", "haptic flash odrive-v3 --port 3852395C3038"],
        "udev" => &["haptic udev | sudo tee /etc/udev/rules.d/70-haptic-bridge.rules"],
        "board backup" => &["haptic board backup board.json"],
        "board restore" => &["haptic board restore board.json"],
        "board report" => &["haptic board report -o report.md"],
        "board name" => &["haptic board name", "haptic board name left-hand"],
        "completions" => &[
            "haptic completions bash > ~/.local/share/bash-completion/completions/haptic",
            "haptic completions --man ~/.local/share/man/man1",
        ],
        _ => &[],
    }
}
