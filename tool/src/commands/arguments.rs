//! Parsers of numbers, directions and words of the command line.

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::render::scene::{FeedForward, MAX_RATE_HZ, MIN_RATE_HZ};
use haptic_bridge::render::velocity::Estimator;
use haptic_host::device_file::DeviceFile;
use haptic_host::error::Failure;
use haptic_host::toml_file::Document;
use haptic_host::vectors::unit;
use haptic_host::words::counted;
use haptic_predict::boards::BoardKind;
use haptic_predict::plausible::{self, FileWarning, Warning};
use haptic_stability::analysis::estimator::LinearEstimator;
use haptic_stability::analysis::several::Member;
use haptic_stability::model::Precision;
use std::path::{Path, PathBuf};

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

impl std::fmt::Display for Numbers {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(out, "{}", self.0.iter().map(f64::to_string).collect::<Vec<_>>().join(","))
    }
}

impl Numbers {
    /// Returns the numbers if there are exactly `count`. `option` and `meaning` appear in the error.
    pub fn exactly(&self, count: usize, option: &str, meaning: &str) -> Result<Vec<f64>, Failure> {
        if self.0.len() == count {
            return Ok(self.0.clone());
        }
        let numbers = counted(self.0.len(), "number");
        let reason = format!("{option} has {numbers}, but this device takes {count} ({meaning})");
        Err(Failure::wrong(reason).remedy("separate them with commas, without spaces"))
    }

    /// Returns one positive number for each of `walls` walls.
    pub fn per_wall(&self, walls: usize, option: &str) -> Result<Vec<f64>, Failure> {
        if self.0.len() != walls {
            let numbers = counted(self.0.len(), "number");
            let reason = format!("{option} has {numbers} for {} (--normal)", counted(walls, "wall"));
            return Err(Failure::wrong(reason).remedy("give one number per --normal, separated by commas"));
        }
        if let Some(wrong) = self.0.iter().find(|value| **value <= 0.0) {
            return Err(Failure::wrong(format!("{option} holds {wrong}")).remedy("every wall needs a positive number"));
        }
        Ok(self.0.clone())
    }

    /// Returns one flag per wall, false for indices in `without` (from 0). Returns an error if all are false.
    pub fn with_feed_forward(without: Option<&Self>, walls: usize, option: &str) -> Result<Vec<bool>, Failure> {
        let mut with = vec![true; walls];
        for index in without.iter().flat_map(|without| &without.0) {
            let wall = with.iter_mut().enumerate().find(|(wall, _)| *wall as f64 == *index);
            let Some((_, wall)) = wall else {
                let reason = format!("{option} names wall {index}, and there are {walls} (--normal)");
                return Err(Failure::wrong(reason).remedy("count the walls from 0, in the order of --normal"));
            };
            *wall = false;
        }
        if walls > 0 && !with.contains(&true) {
            let reason = format!("{option} leaves no wall with a feed-forward");
            return Err(
                Failure::wrong(reason).remedy("name fewer walls: results without any feed-forward are printed too")
            );
        }
        Ok(with)
    }

    /// Returns a direction of `task` entries as a unit vector.
    pub fn unit(&self, task: usize, option: &str) -> Result<Vec<f64>, Failure> {
        let values = self.exactly(task, option, "task directions")?;
        unit(&values).ok_or_else(|| {
            Failure::wrong(format!("{option} is zero, which points nowhere")).remedy("write a direction, such as 0,1")
        })
    }
}

#[derive(clap::Args)]
pub struct DeviceAt {
    /// Device file (TOML)
    pub device: PathBuf,
    /// Joint angles in rad, travels in m, such as 2.4,0.7 [default: the device file's home]
    #[arg(long, value_name = "A,B,..", allow_hyphen_values = true)]
    q: Option<Numbers>,
}

impl DeviceAt {
    pub fn pose(&self, file: &DeviceFile) -> Result<Vec<f64>, Failure> {
        pose(self.q.as_ref(), file)
    }
}

#[derive(clap::Args)]
pub struct HoldingArgs {
    /// Coordinate that a redundant device holds
    #[arg(long, value_name = "COORDINATE", default_value = "orientation", value_parser = admissible_parser())]
    pub admissible: Admissible,
}

#[derive(clap::Args)]
pub struct WallArgs {
    /// Normal of a wall at the tip, of any length; once for each wall that acts
    #[arg(long, value_name = "X,Y,..", required = true, allow_hyphen_values = true)]
    normal: Vec<Numbers>,
    /// Share of each wall in the total stiffness and damping, with several --normal; results are totals [default:
    /// equal]
    #[arg(long, value_name = "A,B,..", allow_hyphen_values = true)]
    share: Option<Numbers>,
    /// Walls whose feed-forward is off while others have it, counted from 0 in the order of --normal
    #[arg(long, value_name = "I,J,..")]
    no_feed_forward: Option<Numbers>,
}

impl WallArgs {
    pub fn count(&self) -> usize {
        self.normal.len()
    }

    pub fn normals(&self) -> impl Iterator<Item = &Numbers> {
        self.normal.iter()
    }

    /// Returns the shares of the walls as typed; `None` for one wall.
    pub fn shares(&self) -> Option<&Numbers> {
        self.share.as_ref().filter(|_| self.normal.len() > 1)
    }

    /// Returns the walls with their shares, at a tip of `task` dimensions.
    pub fn members(&self, task: usize) -> Result<Vec<Member>, Failure> {
        let shares = match &self.share {
            Some(share) => share.per_wall(self.count(), "--share")?,
            None => vec![1.0; self.count()],
        };
        let with = Numbers::with_feed_forward(self.no_feed_forward.as_ref(), self.count(), "--no-feed-forward")?;
        let parts = shares.into_iter().zip(with);
        let member = |(normal, (share, feed_forward)): (&Numbers, _)| {
            Ok(Member { normal: normal.unit(task, "--normal")?, share, feed_forward })
        };
        self.normal.iter().zip(parts).map(member).collect()
    }

    /// Returns the command-line options that describe these walls.
    pub fn options(&self) -> String {
        let mut line: String = self.normal.iter().map(|normal| format!(" --normal={normal}")).collect();
        if let Some(parts) = self.shares() {
            line += &format!(" --share {parts}");
        }
        if let Some(without) = &self.no_feed_forward {
            line += &format!(" --no-feed-forward {without}");
        }
        line
    }
}

pub fn pose(q: Option<&Numbers>, file: &DeviceFile) -> Result<Vec<f64>, Failure> {
    let joints = file.spec().joints;
    match (q, file.description.home) {
        (Some(q), _) => q.exactly(joints, "--q", "joint angles"),
        (None, Some(home)) => Ok(home[..joints].to_vec()),
        (None, None) => Err(Failure::wrong(format!("{} has no [home], so there is no pose", file.path.display()))
            .remedy("give the joint angles with --q")),
    }
}

/// Loads a device file, and returns warnings about implausible values. Without `for_a_loop` there are no warnings about
/// the transmission, because inertia does not depend on it.
pub fn load_device(path: &Path, for_a_loop: bool) -> Result<(DeviceFile, Vec<Warning>), Failure> {
    let document = Document::load(path)?;
    let file = DeviceFile::read(&document)?;
    let mut warnings = plausible::device::file_warnings(&file);
    warnings.retain(|warning| for_a_loop || warning.key.is_none_or(|key| key.name != "transmission"));
    let warnings = warnings.into_iter().map(|warning| warning.locate_in(&document)).collect();
    Ok((file, warnings))
}

/// Returns warnings about implausible joint angles: probably in degrees, or beyond the joints' limits.
pub fn pose_warnings(q: &[f64], file: &DeviceFile) -> Vec<Warning> {
    let mut warnings = plausible::angle_warnings(q, "--q", file.description.kind);
    if warnings.is_empty() {
        warnings = plausible::pose_limit_warnings(q, &file.description);
    }
    warnings.into_iter().map(FileWarning::for_command_line).collect()
}

pub fn check_rate(rate_hz: f64) -> Result<(), Failure> {
    if (MIN_RATE_HZ..=MAX_RATE_HZ).contains(&rate_hz) {
        return Ok(());
    }
    let reason = format!("no board runs at --rate {rate_hz} Hz");
    Err(Failure::wrong(reason).remedy(format!("write {MIN_RATE_HZ} to {MAX_RATE_HZ} Hz")))
}

/// Returns a parser from words to values, with a description of each word for the help page.
pub fn words_parser<T: Copy + Send + Sync + 'static>(
    words: impl IntoIterator<Item = (&'static str, &'static str, T)>,
) -> impl TypedValueParser<Value = T> {
    let words: Vec<_> = words.into_iter().collect();
    let listed = words.iter().map(|(word, about, _)| PossibleValue::new(word).help(*about)).collect();
    parse_words(listed, words.into_iter().map(|(word, _, meaning)| (word, meaning)).collect())
}

/// Returns a parser from words to values, without descriptions.
fn names_parser<T: Copy + Send + Sync + 'static>(
    words: impl IntoIterator<Item = (&'static str, T)>,
) -> impl TypedValueParser<Value = T> {
    let words: Vec<_> = words.into_iter().collect();
    parse_words(words.iter().map(|(word, _)| PossibleValue::new(word)).collect(), words)
}

fn parse_words<T: Copy + Send + Sync + 'static>(
    listed: Vec<PossibleValue>,
    words: Vec<(&'static str, T)>,
) -> impl TypedValueParser<Value = T> {
    PossibleValuesParser::new(listed).try_map(move |word| {
        let known = words.iter().find(|(other, _)| *other == word);
        known.map(|(_, meaning)| *meaning).ok_or("this word has no meaning")
    })
}

pub fn feed_forward_parser() -> impl TypedValueParser<Value = FeedForward> {
    words_parser(FeedForward::ALL.map(|(name, kind)| (name, describe_feed_forward(kind), kind)))
}

pub fn describe_feed_forward(kind: FeedForward) -> &'static str {
    match kind {
        FeedForward::Off => "None",
        FeedForward::Full => "The paper's equation (4)",
        FeedForward::Washout => "The same with a high-pass filter, so that a resting hand is not pushed sideways",
    }
}

/// Parses the name, as in scene files, of a velocity estimator that has a linear analysis.
pub fn estimator_parser() -> impl TypedValueParser<Value = Estimator> {
    let describe = |kind| match kind {
        Estimator::Butterworth => "Backward difference and a 2nd-order Butterworth low-pass",
        Estimator::FirstOrder => "Backward difference and a 1st-order low-pass",
        Estimator::BackwardDifference => "Backward difference alone",
        Estimator::Predicted(_) => "Observer with the motors' torques as inputs and its poles at the cutoff",
        _ => "As in scene files",
    };
    words_parser(LinearEstimator::windowless().map(move |(name, kind)| (name, describe(kind), kind)))
}

pub fn precision_parser() -> impl TypedValueParser<Value = Precision> {
    names_parser(Precision::ALL)
}

/// Parses the name of a board that has firmware.
pub fn board_parser() -> impl TypedValueParser<Value = BoardKind> {
    names_parser(BoardKind::ALL.map(|kind| (kind.name(), kind)))
}

pub fn admissible_parser() -> impl TypedValueParser<Value = Admissible> {
    names_parser(Admissible::ALL)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn linear_estimators_have_no_window() {
        let names: Vec<&str> = LinearEstimator::windowless().map(|(name, _)| name).collect();
        assert_eq!(names, ["butterworth", "first-order", "backward-difference", "predicted"]);
    }

    #[test]
    fn numbers_parse_with_signs_and_spaces_but_without_gaps() {
        assert_eq!("-0.3,1.2".parse(), Ok(Numbers(vec![-0.3, 1.2])));
        assert_eq!(" 1e-3, -2 ".parse(), Ok(Numbers(vec![1.0e-3, -2.0])));
        for wrong in ["", ",", "1,,2", "1;2", "nan", "1,inf"] {
            assert!(wrong.parse::<Numbers>().is_err(), "{wrong}");
        }
    }
}
