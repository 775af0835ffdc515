//! The failure of a command: an exit code, one line that says why, and a remedy. A file with several mistakes gets a
//! line for each.
//!
//! Exit codes (docs/files.md): 0 done, 1 it could not be done, 2 the command or a file is wrong, 3 what was compared
//! differs.

use core::fmt;
use std::borrow::Cow;
use std::process::ExitCode;

/// Whose fault it was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Blame {
    /// The request was sound, but the world did not play along: no board, a singular pose, a full disk. Exit code 1.
    World,
    /// The command line or a file is wrong, and would be wrong again. Exit code 2.
    Request,
    /// Nobody's: two things were compared, and differ. Exit code 3.
    Difference,
}

/// A choice that the user may change to get further; each program knows it under its own name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Choice {
    /// The joint angles of the pose.
    Pose,
    /// The distance that a pose must keep from singularities.
    Clearance,
    /// The size of the wall.
    Patch,
    /// The ripple that a wall may have.
    Ripple,
    /// Which wall is tried.
    Wall,
    /// Permission to overwrite files.
    Overwriting,
    /// Which board.
    Board,
    /// The place where results are kept between runs.
    Kept,
    /// Which of a recording's signals are drawn.
    Shown,
    /// The contents of a recording.
    Fields,
    /// Which firmware is flashed.
    Image,
}

/// A command that did not do what was asked, on one line; a file with several mistakes, a line each.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failure {
    blame: Blame,
    reason: String,
    remedy: Option<String>,
    choice: Option<Choice>,
    /// Further lines.
    also: Vec<String>,
}

impl Failure {
    /// It could not be done (exit code 1).
    pub fn impossible(reason: impl fmt::Display) -> Self {
        Self { blame: Blame::World, reason: reason.to_string(), remedy: None, choice: None, also: Vec::new() }
    }

    /// The command or a file is wrong (exit code 2).
    pub fn wrong(reason: impl fmt::Display) -> Self {
        Self { blame: Blame::Request, reason: reason.to_string(), remedy: None, choice: None, also: Vec::new() }
    }

    /// What was compared differs (exit code 3).
    pub fn different(reason: impl fmt::Display) -> Self {
        Self { blame: Blame::Difference, ..Self::impossible(reason) }
    }

    /// Adds what the user can do about it.
    pub fn remedy(mut self, remedy: impl fmt::Display) -> Self {
        self.remedy = Some(remedy.to_string());
        self
    }

    /// Adds what the user may choose otherwise for the remedy.
    pub fn choose(mut self, choice: Choice) -> Self {
        self.choice = Some(choice);
        self
    }

    /// Adds what is wrong beside, a line each.
    pub fn also(mut self, lines: impl IntoIterator<Item = String>) -> Self {
        self.also.extend(lines);
        self
    }

    /// Returns the choice that the user may change.
    pub fn choice(&self) -> Option<Choice> {
        self.choice
    }

    /// Whose fault it was.
    pub fn blame(&self) -> Blame {
        self.blame
    }

    /// The process's exit code.
    pub fn exit_code(&self) -> ExitCode {
        ExitCode::from(match self.blame {
            Blame::World => 1,
            Blame::Request => 2,
            Blame::Difference => 3,
        })
    }
}

impl fmt::Display for Failure {
    /// The reason is a single line, whatever it was made of.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let one_line = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
        f.write_str(&one_line(&self.reason))?;
        if let Some(remedy) = &self.remedy {
            write!(f, "; {}", one_line(remedy))?;
        }
        self.also.iter().try_for_each(|line| write!(f, "\n{}", one_line(line)))
    }
}

impl std::error::Error for Failure {}

/// Returns a text that is safe to show in a terminal: characters that a terminal would obey, such as the ESC in a name
/// from a file or a board, are written as in JSON. Lines and tabs stay.
pub fn visible(text: &str) -> Cow<'_, str> {
    escaped(text, &['\n', '\t'])
}

/// The same of a name that stands in a line and shall begin none of its own.
pub fn on_one_line(name: &str) -> Cow<'_, str> {
    escaped(name, &[])
}

fn escaped<'t>(text: &'t str, kept: &[char]) -> Cow<'t, str> {
    // Control characters, and marks that turn the direction of what follows or separate lines.
    let marks = |c: char| matches!(c, '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    let obeyed = |c: char| (c.is_control() || marks(c)) && !kept.contains(&c);
    if !text.contains(obeyed) {
        return text.into();
    }
    let mut shown = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        match c {
            c if obeyed(c) => shown.push_str(&format!("\\u{:04x}", u32::from(c))),
            c => shown.push(c),
        }
    }
    shown.into()
}

/// Writes a finished document to standard output, as [`visible`] shows it. A reader that went away (`haptic … | head`) is
/// not an error.
pub fn print(document: &str) -> Result<(), Failure> {
    use std::io::Write;
    let mut out = std::io::stdout().lock();
    let written = out.write_all(visible(document).as_bytes()).and_then(|()| out.flush());
    match written {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(Failure::impossible(format!("standard output cannot be written: {error}")))
        }
        _ => Ok(()),
    }
}

/// Writes to standard error, as [`visible`] shows it. A reader that went away (`haptic … 2>&1 | head`) or a full disk stops
/// no command, least of all one that has motors to turn off: what cannot be said is not said.
pub fn say(text: fmt::Arguments<'_>) {
    write_error(&visible(&text.to_string()));
}

/// The same over what the line of the terminal holds; `clear` leaves the line empty.
pub fn say_over(text: fmt::Arguments<'_>, clear: bool) {
    let end = if clear { "\x1b[2K\r" } else { "" };
    write_error(&format!("\r{}{end}", visible(&text.to_string())));
}

fn write_error(text: &str) {
    use std::io::Write;
    let mut err = std::io::stderr().lock();
    let _ = err.write_all(text.as_bytes()).and_then(|()| err.flush());
}

/// A line on standard error, as `eprintln` but by [`say`]: it never panics.
#[macro_export]
macro_rules! tell {
    ($($text:tt)*) => { $crate::error::say(format_args!("{}\n", format_args!($($text)*))) };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failure_is_one_line() {
        let failure = Failure::wrong("first\nsecond\t third").remedy("do\nthis");
        assert_eq!(failure.to_string(), "first second third; do this");
    }

    #[test]
    fn what_a_terminal_would_obey_is_written_as_in_json() {
        let name = "a\u{1b}[2J\u{9b}31m\r\u{7}\tb\nµ";
        let shown = visible(name);
        assert_eq!(shown, "a\\u001b[2J\\u009b31m\\u000d\\u0007\tb\nµ");
        assert_eq!(on_one_line(name), "a\\u001b[2J\\u009b31m\\u000d\\u0007\\u0009b\\u000aµ");
        let json = format!("\"{}\"", visible("\u{9b}\u{7f}"));
        assert_eq!(serde_json::from_str::<String>(&json).unwrap(), "\u{9b}\u{7f}", "a JSON text means the same");
    }
}
