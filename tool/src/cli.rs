//! The command line as it is read: `--port` ahead of the command, and what to type where something could not be read.

use crate::commands::Command;
use crate::commands::help::{Cli, command};
use clap::error::{ContextKind, ContextValue};
use clap::{ArgMatches, FromArgMatches};
use std::collections::BTreeSet;
use std::error::Error;
use std::ffi::OsString;
use std::num::{IntErrorKind, ParseFloatError, ParseIntError};

/// Parses the process's arguments; prints help or what is wrong with them and exits, as clap does.
pub fn parse() -> Command {
    match read(std::env::args_os().collect()) {
        Ok(command) => command,
        Err(error) => error.exit(),
    }
}

/// The command that these words, the program's own name first, ask for. Errors are clap's, and so are help and version.
pub fn read(words: Vec<OsString>) -> Result<Command, clap::Error> {
    let words = port_after_command(words);
    if let Some(error) = renamed(&words) {
        return Err(error);
    }
    let asked = words.get(1).map(|word| word.to_string_lossy().into_owned()).unwrap_or_default();
    let unread = |error| what_to_type(without_wrong_tip(error, &asked));
    let matches = command().try_get_matches_from(words).map_err(unread)?;
    if let Some(error) = input_overwritten(&matches) {
        return Err(error);
    }
    Ok(Cli::from_arg_matches(&matches)?.command)
}

/// The error for `--force` where two of a command's values name one file: the command would overwrite its own input, or
/// one of its outputs with another.
fn input_overwritten(matches: &ArgMatches) -> Option<clap::Error> {
    if let Some((_, matches)) = matches.subcommand() {
        return input_overwritten(matches);
    }
    if !matches.try_get_one::<bool>("force").ok()?.is_some_and(|force| *force) {
        return None;
    }
    // A group's values are the names of its options.
    let named = matches.ids().filter(|id| matches.try_get_many::<clap::Id>(id.as_str()).is_err());
    let values = named.filter_map(|id| matches.try_get_raw(id.as_str()).ok()?).flatten();
    let mut files = values.filter_map(|value| std::fs::canonicalize(value).ok().filter(|path| path.is_file()));
    let mut seen = BTreeSet::new();
    let twice = files.find(|file| !seen.insert(file.clone()))?;
    let message = format!(
        "{} is named twice, and --force would overwrite what this command reads or writes there: choose another name for \
         the file to write\n",
        twice.display()
    );
    Some(clap::Error::raw(clap::error::ErrorKind::ArgumentConflict, message).with_cmd(&command()))
}

/// Commands that had another name in the version before, each with what to type now.
const RENAMED: &[(&str, &str)] = &[
    ("backup", "haptic board backup"),
    ("clear", "haptic faults --clear"),
    ("dfu", "haptic board dfu"),
    ("estimators", "haptic tune estimators"),
    ("latency", "haptic board latency"),
    ("list", "haptic board list"),
    ("monitor", "haptic view"),
    ("name", "haptic board name"),
    ("plan", "haptic check"),
    ("restart", "haptic board restart"),
    ("restore", "haptic board restore"),
    ("save", "haptic board save"),
];

/// The error that says what to type instead of a spelling of the previous version.
fn renamed(words: &[OsString]) -> Option<clap::Error> {
    let mut words = words.iter().skip(1).filter_map(|word| word.to_str());
    let asked = words.next()?;
    let asked = if asked == "help" { words.next()? } else { asked };
    let told = |old: &str, now: &str| {
        let message = format!("`haptic {old}` is now called `{now}`\n");
        Some(clap::Error::raw(clap::error::ErrorKind::InvalidSubcommand, message).with_cmd(&command()))
    };
    if asked == "stream" && words.any(|word| word == "--csv" || word.starts_with("--csv=")) {
        return told("stream --csv", "haptic record FILE.csv");
    }
    RENAMED.iter().find(|(old, _)| *old == asked).and_then(|(old, now)| told(old, now))
}

/// No tip to pass an option that a command has not got as a value, which it would then take for the name of a file; and
/// the option where a file to write stands without it.
fn without_wrong_tip(mut error: clap::Error, asked: &str) -> clap::Error {
    if error.kind() != clap::error::ErrorKind::UnknownArgument {
        return error;
    }
    let as_value = |tip: &clap::builder::StyledStr| tip.to_string().contains("as a value, use '-- ");
    if let Some(ContextValue::StyledStrs(mut tips)) = error.remove(ContextKind::Suggested) {
        tips.retain(|tip| !as_value(tip));
        if !tips.is_empty() {
            error.insert(ContextKind::Suggested, ContextValue::StyledStrs(tips));
        }
    }
    if let Some(ContextValue::String(word)) = error.get(ContextKind::InvalidArg)
        && word.parse::<f64>().is_ok()
    {
        let tip = "numbers that belong together are written with commas: '--normal 0,1'".to_string().into();
        error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![tip]));
    }
    if let (Some(ContextValue::String(word)), "new") = (error.get(ContextKind::InvalidArg), asked)
        && !word.starts_with('-')
    {
        let tip = format!("to write this file, use '-o {word}'").into();
        error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![tip]));
    }
    error
}

/// Replaces the parser's own message by words on what to type, if a number could not be read.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::commands::help::examples;

    #[test]
    fn the_command_line_is_consistent() {
        command().debug_assert();
    }

    #[test]
    fn every_command_stands_under_a_heading_and_says_what_it_is_for() {
        let help = command().render_long_help().to_string();
        let mut shown = 0;
        for found in command().get_subcommands() {
            let about = found.get_about().map(ToString::to_string).unwrap_or_default();
            assert!(about.len() > 10 && !about.ends_with('.'), "{}: \"{about}\"", found.get_name());
            assert_eq!(help.contains(&about), !found.is_hide_set(), "{} on the help page", found.get_name());
            shown += usize::from(!found.is_hide_set());
        }
        assert!(shown <= 30, "{shown} commands are more than a person keeps in mind");
    }

    /// The words of every command, and of those under it.
    fn every_command() -> Vec<String> {
        let mut left = vec![(String::new(), command())];
        let mut all = Vec::new();
        while let Some((above, command)) = left.pop() {
            for under in command.get_subcommands() {
                let words = format!("{above}{}", under.get_name());
                all.push(words.clone());
                left.push((words + " ", under.clone()));
            }
        }
        all
    }

    #[test]
    fn every_example_is_understood() {
        for command in every_command() {
            for line in examples(&command) {
                // The rest of the line belongs to the shell.
                let words = line.split(['|', '>']).next().unwrap_or_default().split_whitespace();
                let read = read(words.map(OsString::from).collect());
                assert!(read.is_ok(), "{line}: {}", read.err().unwrap());
                assert!(line.starts_with(&format!("haptic {command}")), "{line} under {command}");
            }
        }
    }

    #[test]
    fn a_spelling_of_the_version_before_is_answered_with_todays() {
        let all = every_command();
        for (old, now) in RENAMED {
            assert!(!all.iter().any(|command| command == old), "{old}");
            let words = now.trim_start_matches("haptic ").split(" --").next().unwrap();
            assert!(all.iter().any(|command| command == words), "{now}");
            for line in
                [format!("haptic {old} --json"), format!("haptic help {old}"), format!("haptic --port sim {old}")]
            {
                let error = read(line.split(' ').map(OsString::from).collect()).err().unwrap();
                assert_eq!(error.exit_code(), 2);
                assert!(error.to_string().contains(&format!("`haptic {old}` is now called `{now}`")), "{error}");
            }
        }
    }

    #[test]
    fn force_overwrites_no_input_of_the_same_command() {
        let folder = tempfile::tempdir().unwrap();
        let [input, other] = ["a.toml", "b.toml"].map(|name| folder.path().join(name).display().to_string());
        std::fs::write(&input, "").unwrap();
        std::fs::write(&other, "").unwrap();
        // One folder up and down again is the same file.
        let around = format!("{}/../{}/a.toml", folder.path().display(), folder.path().file_name().unwrap().display());
        let lines = [
            "check IN --svg OUT",
            "report IN --out OUT",
            "tune IN --normal 0,1 --out OUT",
            "plot IN --svg OUT",
            "range IN --normal 0,1 --rate 1000 --cutoff 20 --png OUT",
            "map IN --normal 0,1 --svg OUT",
            "design IN --normal 0,1 --svg OUT",
            "new scene --device IN -o OUT",
            "precompute IN --kind frozen -o OUT",
            "device --read IN -o OUT",
        ];
        for line in lines {
            let read = |output: &str| {
                let words = format!("haptic {line} --force").replace("IN", &input).replace("OUT", output);
                read(words.split(' ').map(OsString::from).collect())
            };
            for output in [&input, &around] {
                let error = read(output).err().unwrap_or_else(|| panic!("{line}")).to_string();
                assert!(error.contains("is named twice"), "{line}: {error}");
            }
            assert!(!read(&other).err().is_some_and(|error| error.to_string().contains("twice")), "{line}");
        }
    }

    #[test]
    fn tips_say_what_helps() {
        let said = |line: &str| read(line.split_whitespace().map(OsString::from).collect()).err().unwrap().to_string();
        for line in ["haptic view --json", "haptic check a.toml --jsn", "haptic new --json"] {
            assert!(!said(line).contains("'-- "), "{line}: {}", said(line));
        }
        assert!(said("haptic check a.toml --jsn").contains("'--json'"), "{}", said("haptic check a.toml --jsn"));
        assert!(said("haptic range a.toml --rate 1000 --cutoff 20 --normal 0 1").contains("commas: '--normal 0,1'"));
        assert!(said("haptic new five-bar mine.toml").contains("use '-o mine.toml'"));
    }

    #[test]
    fn negative_numbers_are_values_of_every_numeric_option() {
        let cases = [
            "range devices/a.toml --normal 0,1 --cutoff 20 --rate -5",
            "tune a.toml --normal 0,1 --speed -5",
            "measure-range a.toml --normal 0,1 --kd -5 --washout -1",
            "gains --stiffness -5",
            "gains --wall -1",
            "stream --seconds -5",
            "stream --rate -5",
            "rules --power -5",
            "rules --torque -1,2",
            "rules --bus-min -3",
        ];
        for case in cases {
            let words = format!("haptic {case}");
            let Err(error) = read(words.split_whitespace().map(OsString::from).collect()) else { continue };
            assert!(error.to_string().contains("invalid value '-"), "{case}: {error}");
        }
    }
}
