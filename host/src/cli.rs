//! The command line as a whole: the help page with its commands under headings, and how angles and vectors are read.

use crate::commands::{Command, HEADINGS, list_of_fields};
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::error::ContextKind;
use clap::{CommandFactory, FromArgMatches, Parser};
use haptic::error::Failure;
use haptic::plausible::counted;
use haptic::vectors::unit;
use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::render::scene::FeedForward;
use std::error::Error;
use std::ffi::OsString;
use std::num::{IntErrorKind, ParseFloatError, ParseIntError};

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

/// Lines to type, for the help of a command and its page of the manual. Every one of them is understood: a test reads
/// them.
pub fn examples(command: &str) -> &'static [&'static str] {
    match command {
        "check" => &["haptic check devices/haply-2diy.toml devices/scenes/haply-2diy/wall.toml"],
        "model" => &["haptic model devices/coupled-five-bar.toml --q 2.6,1.75 --normal 0.94,-0.34 --force 1"],
        "map" => &["haptic map devices/coupled-five-bar.toml --normal 0,1 --png map.png"],
        "plan" => &["haptic plan devices/haply-2diy.toml devices/scenes/haply-2diy/wall.toml"],
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
        "scene" => &["haptic scene devices/scenes/haply-2diy/wall.toml"],
        "gains" => &["haptic gains --stiffness 800 --damping 2", "haptic gains --wall 1 --feed-forward off"],
        "rules" => &["haptic rules --torque 0.1,0.1 --host disarm", "haptic rules --json"],
        "stream" => &[
            "haptic stream",
            "haptic stream --csv contact.csv --seconds 10",
            "haptic stream --csv - --fields q,force,rendered --rate 5000 | head -n 100",
        ],
        "record" => &["haptic record contact.mcap", "haptic record contact.csv --rate 1000 --seconds 10"],
        "plot" => {
            &["haptic plot contact.mcap --svg contact.svg", "haptic plot contact.csv --show force --png force.png"]
        }
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

/// Parses the process's arguments; prints help or what is wrong with them and exits, as clap does.
pub fn parse() -> Command {
    match read(std::env::args_os().collect()) {
        Ok(command) => command,
        Err(error) => error.exit(),
    }
}

/// The command that these words, the program's own name first, ask for. Errors are clap's, and so are help and version.
pub fn read(words: Vec<OsString>) -> Result<Command, clap::Error> {
    let matches = command().try_get_matches_from(port_after_command(words)).map_err(what_to_type)?;
    Ok(Cli::from_arg_matches(&matches)?.command)
}

/// Where a number could not be read, what would be one, in the place of what the parser stumbled over.
fn what_to_type(error: clap::Error) -> clap::Error {
    let stumbled = error.source();
    let wanted = match stumbled.and_then(|source| source.downcast_ref::<ParseIntError>()).map(ParseIntError::kind) {
        Some(IntErrorKind::InvalidDigit | IntErrorKind::Empty) => "write a whole number, such as 12",
        _ if stumbled.is_some_and(|source| source.is::<ParseFloatError>()) => "write a number, such as 0.5 or 2e3",
        _ => return error,
    };
    let about = |kind| error.get(kind).map(ToString::to_string).unwrap_or_default();
    let (value, option) = (about(ContextKind::InvalidValue), about(ContextKind::InvalidArg));
    let message = format!("invalid value '{value}' for '{option}': {wanted}");
    clap::Error::raw(error.kind(), message).with_cmd(&command())
}

/// Lets `--port` stand before the command as well: `haptic --port sim info` is `haptic info --port sim`.
fn port_after_command(mut words: Vec<OsString>) -> Vec<OsString> {
    let ahead = match words.get(1).and_then(|word| word.to_str()) {
        Some("--port") => 2,
        Some(word) if word.starts_with("--port=") => 1,
        _ => return words,
    };
    if words.len() > 1 + ahead {
        words[1..2 + ahead].rotate_right(1);
    }
    words
}

/// A list of numbers separated by commas, such as `-0.3,1.2`.
#[derive(Clone, Debug, PartialEq)]
pub struct Numbers(pub Vec<f64>);

impl std::str::FromStr for Numbers {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let number = |part: &str| match part.trim().parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(number),
            Ok(_) => Err(format!("`{}` is not a finite number", part.trim())),
            Err(_) => {
                Err(format!("`{}` is not a number; write numbers separated by commas, such as 0.3,-1.2", part.trim()))
            }
        };
        text.split(',').map(number).collect::<Result<Vec<f64>, String>>().map(Numbers)
    }
}

impl Numbers {
    /// The numbers, if there are exactly `count`; `option` and `meaning` are for the message.
    pub fn exactly(self, count: usize, option: &str, meaning: &str) -> Result<Vec<f64>, Failure> {
        if self.0.len() == count {
            return Ok(self.0);
        }
        let numbers = counted(self.0.len(), "number");
        let reason = format!("{option} has {numbers}, but this device takes {count} ({meaning})");
        Err(Failure::wrong(reason).remedy("separate them with commas, without spaces"))
    }

    /// One positive number for each of `walls` walls.
    pub fn per_wall(self, walls: usize, option: &str) -> Result<Vec<f64>, Failure> {
        if self.0.len() != walls {
            let numbers = counted(self.0.len(), "number");
            let reason = format!("{option} has {numbers} for {} (--normal)", counted(walls, "wall"));
            return Err(Failure::wrong(reason).remedy("give one number per --normal, separated by commas"));
        }
        if let Some(wrong) = self.0.iter().find(|value| **value <= 0.0) {
            return Err(Failure::wrong(format!("{option} holds {wrong}")).remedy("every wall needs a positive number"));
        }
        Ok(self.0)
    }

    /// Which of `walls` walls have the feed-forward: all but those that `without` counts, from 0, and some.
    pub fn with_feed_forward(without: Option<Self>, walls: usize, option: &str) -> Result<Vec<bool>, Failure> {
        let mut with = vec![true; walls];
        for index in without.map_or_else(Vec::new, |without| without.0) {
            let wall = with.iter_mut().enumerate().find(|(wall, _)| *wall as f64 == index);
            let Some((_, wall)) = wall else {
                let reason = format!("{option} names wall {index}, and there are {walls} (--normal)");
                return Err(Failure::wrong(reason).remedy("count the walls from 0, in the order of --normal"));
            };
            *wall = false;
        }
        if walls > 0 && !with.contains(&true) {
            let reason = format!("{option} leaves no wall with a feed-forward");
            return Err(Failure::wrong(reason).remedy("leave one out: results without any stand beside those with it"));
        }
        Ok(with)
    }

    /// A direction of `task` entries, made a unit vector.
    pub fn unit(self, task: usize, option: &str) -> Result<Vec<f64>, Failure> {
        let values = self.exactly(task, option, "task directions")?;
        unit(&values).ok_or_else(|| {
            Failure::wrong(format!("{option} is zero, which points nowhere")).remedy("write a direction")
        })
    }
}

/// Reads one of these words as what it stands for; each comes with what it is, for the help page.
pub fn one_of<T: Copy + Send + Sync + 'static>(
    words: impl IntoIterator<Item = (&'static str, &'static str, T)>,
) -> impl TypedValueParser<Value = T> {
    let words: Vec<_> = words.into_iter().collect();
    let listed = words.iter().map(|(word, about, _)| PossibleValue::new(word).help(*about));
    PossibleValuesParser::new(listed).try_map(move |word| {
        let known = words.iter().find(|(other, ..)| *other == word);
        known.map(|(.., meaning)| *meaning).ok_or("this word stands for nothing")
    })
}

/// A feed-forward, by its name.
pub fn feed_forward() -> impl TypedValueParser<Value = FeedForward> {
    one_of(FeedForward::ALL.map(|(name, kind)| (name, what(kind), kind)))
}

/// What a feed-forward is.
pub fn what(kind: FeedForward) -> &'static str {
    match kind {
        FeedForward::Off => "None",
        FeedForward::Full => "The paper's equation (4)",
        FeedForward::Washout => "The same, gone at rest, so that a resting hand is not pushed sideways",
    }
}

/// What a redundant device holds, by its name.
pub fn admissible(text: &str) -> Result<Admissible, String> {
    let known = Admissible::ALL.iter().find(|(name, _)| *name == text).map(|(_, choice)| *choice);
    known.ok_or_else(|| format!("write one of {}", Admissible::ALL.map(|(name, _)| name).join(", ")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        command().debug_assert();
    }

    #[test]
    fn every_command_stands_under_a_heading_and_says_what_it_is_for() {
        let help = command().render_long_help().to_string();
        for found in command().get_subcommands() {
            let about = found.get_about().map(ToString::to_string).unwrap_or_default();
            assert!(about.len() > 10 && !about.ends_with('.'), "{}: \"{about}\"", found.get_name());
            assert!(help.contains(&about), "{} is not on the help page", found.get_name());
        }
    }

    #[test]
    fn every_example_is_understood() {
        for command in command().get_subcommands() {
            for line in examples(command.get_name()) {
                // What a shell does with the rest of the line is not ours.
                let words = line.split(['|', '>']).next().unwrap_or_default().split_whitespace();
                let read = read(words.map(OsString::from).collect());
                assert!(read.is_ok(), "{line}: {}", read.err().unwrap());
                assert_eq!(line.split_whitespace().nth(1), Some(command.get_name()));
            }
        }
    }

    #[test]
    fn negative_numbers_are_values_of_every_numeric_option() {
        let cases = [
            "range devices/a.toml --normal 0,1 --cutoff 20 --rate -5",
            "plan a.toml b.toml --speed -5",
            "measure-range a.toml --normal 0,1 --kd -5 --washout -1",
            "gains --stiffness -5",
            "gains --wall -1",
            "stream --seconds -5",
            "stream --rate -5",
            "demo --seed -5",
            "rules --torque -1,2",
            "rules --bus-min -3",
        ];
        for case in cases {
            let words = format!("haptic {case}");
            let Err(error) = read(words.split_whitespace().map(OsString::from).collect()) else { continue };
            assert!(error.to_string().contains("invalid value '-"), "{case}: {error}");
        }
    }

    #[test]
    fn numbers_parse_with_signs_and_spaces_but_not_with_gaps() {
        assert_eq!("-0.3,1.2".parse(), Ok(Numbers(vec![-0.3, 1.2])));
        assert_eq!(" 1e-3, -2 ".parse(), Ok(Numbers(vec![1.0e-3, -2.0])));
        for wrong in ["", ",", "1,,2", "1;2", "nan", "1,inf"] {
            assert!(wrong.parse::<Numbers>().is_err(), "{wrong}");
        }
    }
}
