//! Reads the command line: allows `--port` before the command, and suggests what to type after a mistake.

use crate::commands::Command;
use crate::commands::help::{Cli, command};
use clap::error::{ContextKind, ContextValue};
use clap::{ArgMatches, FromArgMatches};
use std::collections::BTreeSet;
use std::error::Error;
use std::ffi::OsString;
use std::num::{IntErrorKind, ParseFloatError, ParseIntError};

/// Parses the arguments of the process. Prints help or an error and exits, as clap does.
pub fn parse() -> Command {
    match parse_words(std::env::args_os().collect()) {
        Ok(command) => command,
        Err(error) => error.exit(),
    }
}

/// Parses a command line that begins with the program's name. Errors are clap's; help and version are errors too.
pub fn parse_words(words: Vec<OsString>) -> Result<Command, clap::Error> {
    let words = move_port_after_command(words);
    if let Some(error) = renamed_error(&words) {
        return Err(error);
    }
    let typed = words.get(1).map(|word| word.to_string_lossy().into_owned()).unwrap_or_default();
    let helpful = |error| explain_number(correct_tips(error, &typed));
    let matches = command().try_get_matches_from(words).map_err(helpful)?;
    if let Some(error) = overwrite_error(&matches) {
        return Err(error);
    }
    Ok(Cli::from_arg_matches(&matches)?.command)
}

/// Returns an error if `--force` would overwrite an input, or an output with another, of the same command.
fn overwrite_error(matches: &ArgMatches) -> Option<clap::Error> {
    if let Some((_, matches)) = matches.subcommand() {
        return overwrite_error(matches);
    }
    if !matches.try_get_one::<bool>("force").ok()?.is_some_and(|force| *force) {
        return None;
    }
    // Skips groups, whose values are names of options and not files.
    let named = matches.ids().filter(|id| matches.try_get_many::<clap::Id>(id.as_str()).is_err());
    let values = named.filter_map(|id| matches.try_get_raw(id.as_str()).ok()?).flatten();
    let mut files = values.filter_map(|value| std::fs::canonicalize(value).ok().filter(|path| path.is_file()));
    let mut seen = BTreeSet::new();
    let twice = files.find(|file| !seen.insert(file.clone()))?;
    let message = format!(
        "{} is named twice, and --force would overwrite an input or another output of this command: choose another name \
         for the file to write\n",
        twice.display()
    );
    Some(clap::Error::raw(clap::error::ErrorKind::ArgumentConflict, message).with_cmd(&command()))
}

/// Old and new spelling of the commands that the previous version calls by another name.
const RENAMED_COMMANDS: &[(&str, &str)] = &[
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

/// Returns an error with the present spelling of a command or option that was renamed.
fn renamed_error(words: &[OsString]) -> Option<clap::Error> {
    let mut words = words.iter().skip(1).filter_map(|word| word.to_str());
    let typed = words.next()?;
    let typed = if typed == "help" { words.next()? } else { typed };
    let renamed_to = |old: &str, now: &str| {
        let message = format!("`haptic {old}` is now called `{now}`\n");
        Some(clap::Error::raw(clap::error::ErrorKind::InvalidSubcommand, message).with_cmd(&command()))
    };
    if typed == "stream" && words.any(|word| word == "--csv" || word.starts_with("--csv=")) {
        return renamed_to("stream --csv", "haptic record FILE.csv");
    }
    RENAMED_COMMANDS.iter().find(|(old, _)| *old == typed).and_then(|(old, now)| renamed_to(old, now))
}

/// Corrects clap's suggestions: never suggests to pass an unknown option as a value, because the value would become a
/// file name; suggests commas between numbers, and `-o` if `haptic new` got a file without it.
fn correct_tips(mut error: clap::Error, typed: &str) -> clap::Error {
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
    if let (Some(ContextValue::String(word)), "new") = (error.get(ContextKind::InvalidArg), typed)
        && !word.starts_with('-')
    {
        let tip = format!("to write this file, use '-o {word}'").into();
        error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![tip]));
    }
    error
}

/// Replaces clap's message by an example if a number cannot be parsed.
fn explain_number(error: clap::Error) -> clap::Error {
    let source = error.source();
    let advice = match source.and_then(|source| source.downcast_ref::<ParseIntError>()).map(ParseIntError::kind) {
        Some(IntErrorKind::InvalidDigit | IntErrorKind::Empty) => "write a whole number, such as 12",
        _ if source.is_some_and(|source| source.is::<ParseFloatError>()) => "write a number, such as 0.5 or 2e3",
        _ => return error,
    };
    let context = |kind| error.get(kind).map(ToString::to_string).unwrap_or_default();
    let (value, option) = (context(ContextKind::InvalidValue), context(ContextKind::InvalidArg));
    let message = format!("invalid value '{value}' for '{option}': {advice}");
    clap::Error::raw(error.kind(), message).with_cmd(&command())
}

/// Moves a `--port` before the command behind it: `haptic --port sim info` becomes `haptic info --port sim`.
fn move_port_after_command(mut words: Vec<OsString>) -> Vec<OsString> {
    let length = match words.get(1).and_then(|word| word.to_str()) {
        Some("--port") => 2,
        Some(word) if word.starts_with("--port=") => 1,
        _ => return words,
    };
    if words.len() > 1 + length {
        words[1..2 + length].rotate_right(1);
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::commands::help::examples;

    #[test]
    fn clap_accepts_the_command_line() {
        command().debug_assert();
    }

    #[test]
    fn help_lists_every_command_with_a_description() {
        let help = command().render_long_help().to_string();
        let mut shown = 0;
        for command in super::command().get_subcommands() {
            let about = command.get_about().map(ToString::to_string).unwrap_or_default();
            assert!(about.len() > 10 && !about.ends_with('.'), "{}: \"{about}\"", command.get_name());
            assert_eq!(help.contains(&about), !command.is_hide_set(), "{} on the help page", command.get_name());
            shown += usize::from(!command.is_hide_set());
        }
        assert!(shown <= 32, "{shown} commands are too many for one help page");
    }

    fn command_names() -> Vec<String> {
        let mut pending = vec![(String::new(), command())];
        let mut names = Vec::new();
        while let Some((above, command)) = pending.pop() {
            for sub in command.get_subcommands() {
                let words = format!("{above}{}", sub.get_name());
                names.push(words.clone());
                pending.push((words + " ", sub.clone()));
            }
        }
        names
    }

    #[test]
    fn every_example_parses() {
        for command in command_names() {
            for line in examples(&command) {
                // Parses only the part before a pipe or a redirection.
                let words = line.split(['|', '>']).next().unwrap_or_default().split_whitespace();
                let parsed = parse_words(words.map(OsString::from).collect());
                assert!(parsed.is_ok(), "{line}: {}", parsed.err().unwrap());
                assert!(line.starts_with(&format!("haptic {command}")), "{line} under {command}");
            }
        }
    }

    #[test]
    fn old_spellings_cause_an_error_with_the_new_spelling() {
        let names = command_names();
        for (old, now) in RENAMED_COMMANDS {
            assert!(!names.iter().any(|command| command == old), "{old}");
            let words = now.trim_start_matches("haptic ").split(" --").next().unwrap();
            assert!(names.iter().any(|command| command == words), "{now}");
            for line in
                [format!("haptic {old} --json"), format!("haptic help {old}"), format!("haptic --port sim {old}")]
            {
                let error = parse_words(line.split(' ').map(OsString::from).collect()).err().unwrap();
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
        // A path through the folder's parent names the same file.
        let detour = format!("{}/../{}/a.toml", folder.path().display(), folder.path().file_name().unwrap().display());
        let lines = [
            "check IN --svg OUT",
            "report IN --out OUT",
            "tune IN --normal 0,1 --out OUT",
            "plot IN --svg OUT",
            "range IN --normal 0,1 --rate 1000 --cutoff 20 --png OUT",
            "map IN --normal 0,1 --svg OUT",
            "design IN --normal 0,1 --svg OUT",
            "new scene --device IN -o OUT",
            "device --read IN -o OUT",
        ];
        for line in lines {
            let parse = |output: &str| {
                let words = format!("haptic {line} --force").replace("IN", &input).replace("OUT", output);
                parse_words(words.split(' ').map(OsString::from).collect())
            };
            for output in [&input, &detour] {
                let error = parse(output).err().unwrap_or_else(|| panic!("{line}")).to_string();
                assert!(error.contains("is named twice"), "{line}: {error}");
            }
            assert!(!parse(&other).err().is_some_and(|error| error.to_string().contains("twice")), "{line}");
        }
    }

    #[test]
    fn suggestions_name_the_right_option() {
        let error =
            |line: &str| parse_words(line.split_whitespace().map(OsString::from).collect()).err().unwrap().to_string();
        for line in ["haptic view --json", "haptic check a.toml --jsn", "haptic new --json"] {
            assert!(!error(line).contains("'-- "), "{line}: {}", error(line));
        }
        assert!(error("haptic check a.toml --jsn").contains("'--json'"), "{}", error("haptic check a.toml --jsn"));
        assert!(error("haptic range a.toml --rate 1000 --cutoff 20 --normal 0 1").contains("commas: '--normal 0,1'"));
        assert!(error("haptic new five-bar mine.toml").contains("use '-o mine.toml'"));
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
            let Err(error) = parse_words(words.split_whitespace().map(OsString::from).collect()) else { continue };
            assert!(error.to_string().contains("invalid value '-"), "{case}: {error}");
        }
    }
}
