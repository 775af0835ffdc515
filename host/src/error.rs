//! The failure of a command: an exit code, a reason on one line, and a remedy. A file with several errors gets one line
//! for each.
//!
//! Exit codes (docs/files.md): 0 done, 1 not possible, 2 the command or a file is wrong, 3 the compared things differ.

use core::fmt;
use std::borrow::Cow;
use std::process::ExitCode;

/// The cause of a failure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Blame {
    /// A valid request could not be carried out, as without a board or on a full disk. Exit code 1.
    System,
    /// The command line or a file is wrong. Exit code 2.
    Request,
    /// Two things that were compared differ. Exit code 3.
    Difference,
}

/// An option that the user may change to avoid the failure. Each program has its own name for the option.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Choice {
    /// The joint angles of the pose.
    Pose,
    /// The required distance of a pose from singularities.
    Clearance,
    /// The size of the wall.
    Patch,
    /// The largest ripple of a wall.
    Ripple,
    /// The wall to test.
    Wall,
    /// Permission to overwrite files.
    Overwriting,
    /// The board.
    Board,
    /// The file that keeps results between runs.
    ResultsFile,
    /// The signals of a recording to draw.
    DrawnSignals,
    /// The contents of a recording.
    Fields,
    /// The firmware to flash.
    Image,
    /// Conversion of a model in another format.
    Conversion,
    /// The body of a converted model whose origin is the tip.
    Tip,
    /// The joints of a converted model that move.
    Joints,
}

/// A failed command: a reason on one line, and further lines for a file with several errors.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failure {
    blame: Blame,
    reason: String,
    remedy: Option<String>,
    choice: Option<Choice>,
    further_lines: Vec<String>,
}

impl Failure {
    /// Creates a failure of a valid request (exit code 1).
    pub fn impossible(reason: impl fmt::Display) -> Self {
        Self { blame: Blame::System, reason: reason.to_string(), remedy: None, choice: None, further_lines: Vec::new() }
    }
    /// Creates a failure of a wrong command or file (exit code 2).
    pub fn wrong(reason: impl fmt::Display) -> Self {
        Self { blame: Blame::Request, ..Self::impossible(reason) }
    }
    /// Creates the failure of a comparison (exit code 3).
    pub fn different(reason: impl fmt::Display) -> Self {
        Self { blame: Blame::Difference, ..Self::impossible(reason) }
    }
    /// Adds the remedy.
    pub fn remedy(mut self, remedy: impl fmt::Display) -> Self {
        self.remedy = Some(remedy.to_string());
        self
    }
    /// Adds the option that the user may change.
    pub fn choose(mut self, choice: Choice) -> Self {
        self.choice = Some(choice);
        self
    }
    /// Adds further errors, one line each.
    pub fn with_further_lines(mut self, lines: impl IntoIterator<Item = String>) -> Self {
        self.further_lines.extend(lines);
        self
    }
    /// Returns the option that the user may change.
    pub fn choice(&self) -> Option<Choice> {
        self.choice
    }
    /// Returns the cause of the failure.
    pub fn blame(&self) -> Blame {
        self.blame
    }
    /// Returns the exit code of the process.
    pub fn exit_code(&self) -> ExitCode {
        ExitCode::from(match self.blame {
            Blame::System => 1,
            Blame::Request => 2,
            Blame::Difference => 3,
        })
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let one_line = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
        f.write_str(&one_line(&self.reason))?;
        if let Some(remedy) = &self.remedy {
            write!(f, "; {}", one_line(remedy))?;
        }
        self.further_lines.iter().try_for_each(|line| write!(f, "\n{}", one_line(line)))
    }
}

impl std::error::Error for Failure {}

/// Makes a text safe for a terminal: escapes control characters, such as an ESC in a board's name, as in JSON. Keeps
/// newlines and tabs.
pub fn visible(text: &str) -> Cow<'_, str> {
    escape(text, &['\n', '\t'])
}

/// Like [`visible`], but also escapes newlines and tabs, for a name within a line.
pub fn on_one_line(name: &str) -> Cow<'_, str> {
    escape(name, &[])
}

fn escape<'t>(text: &'t str, allowed: &[char]) -> Cow<'t, str> {
    // Direction marks and line separators.
    let marks = |c: char| matches!(c, '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    let is_unsafe = |c: char| (c.is_control() || marks(c)) && !allowed.contains(&c);
    if !text.contains(is_unsafe) {
        return text.into();
    }
    let mut shown = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        match c {
            c if is_unsafe(c) => shown.push_str(&format!("\\u{:04x}", u32::from(c))),
            c => shown.push(c),
        }
    }
    shown.into()
}

/// Writes a complete document to standard output, escaped by [`visible`]. A closed pipe (`haptic … | head`) is not an
/// error.
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

/// Writes to standard error, escaped by [`visible`]. Ignores write errors, because a closed pipe (`haptic … 2>&1 |
/// head`) or a full disk must not stop a command that still has to turn motors off.
pub fn say(text: fmt::Arguments<'_>) {
    write_error(&visible(&text.to_string()));
}

/// Like [`say`], but overwrites the terminal's present line. If `clear`, empties the line afterwards.
pub fn overwrite_line(text: fmt::Arguments<'_>, clear: bool) {
    let end = if clear { "\x1b[2K\r" } else { "" };
    write_error(&format!("\r{}{end}", visible(&text.to_string())));
}

fn write_error(text: &str) {
    use std::io::Write;
    let mut err = std::io::stderr().lock();
    let _ = err.write_all(text.as_bytes()).and_then(|()| err.flush());
}

/// Writes a line to standard error by [`say`]. Unlike `eprintln`, it never panics.
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
    fn control_characters_are_escaped_as_in_json() {
        let name = "a\u{1b}[2J\u{9b}31m\r\u{7}\tb\nµ";
        let shown = visible(name);
        assert_eq!(shown, "a\\u001b[2J\\u009b31m\\u000d\\u0007\tb\nµ");
        assert_eq!(on_one_line(name), "a\\u001b[2J\\u009b31m\\u000d\\u0007\\u0009b\\u000aµ");
        let json = format!("\"{}\"", visible("\u{9b}\u{7f}"));
        assert_eq!(serde_json::from_str::<String>(&json).unwrap(), "\u{9b}\u{7f}", "JSON decodes it to the same text");
    }
}
