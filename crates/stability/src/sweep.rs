//! Long computations on many items, on all cores, with progress display. Ctrl-C interrupts a computation, and the same
//! command resumes it. A terminal shows the progress in one line; otherwise each stage prints lines.
//!
//! Results are in the order of the items, and stored results equal recomputed results to the bit. The result therefore
//! does not depend on the number of cores, the order of the work or interruptions.

use haptic_host::error::{Choice, Failure};
use haptic_host::output::{self, Overwrite};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::{ErrorKind, IsTerminal};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// Interval between writes of the checkpoint. A crash loses at most this much work.
const WRITE_INTERVAL: Duration = Duration::from_secs(2);
/// Smallest pause after a write, as a multiple of the duration of the write.
const MIN_PAUSE_FACTOR: u32 = 20;

/// A stage with at least this many items prints a progress line after each quarter.
const LONG_STAGE_ITEMS: usize = 16;

/// State that is stored between runs.
#[derive(Debug, Default, Deserialize, Serialize)]
struct Checkpoint {
    /// Version of the tool. Another version may compute other numbers.
    version: String,
    command: String,
    /// All inputs that determine the results, as text.
    question: String,
    stages: BTreeMap<String, Stage>,
}

/// A list of items that a command computes in one call of [`Sweep::map`].
#[derive(Debug, Default, Deserialize, Serialize)]
struct Stage {
    of: usize,
    /// Results by item index: postcard's bytes as hex, because decimals lose values that are not finite.
    done: BTreeMap<usize, String>,
}

impl Checkpoint {
    /// Returns true if command, version and inputs are equal.
    fn matches(&self, other: &Self) -> bool {
        (&self.version, &self.command, &self.question) == (&other.version, &other.command, &other.question)
    }
}

/// A long computation with progress display and stored results.
pub struct Sweep {
    interrupted: Box<dyn Fn() -> bool + Send + Sync>,
    file: Option<PathBuf>,
    display: Display,
    state: Mutex<State>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Display {
    Never,
    InPlace,
    Lines,
}

/// Environment variable that suppresses progress lines, for programs that show the standard error of their commands.
pub const QUIET_VARIABLE: &str = "HAPTIC_NO_PROGRESS";

struct State {
    checkpoint: Checkpoint,
    /// Time after which the checkpoint is written again.
    due: Instant,
}

impl Sweep {
    /// Creates a sweep that stores its results in `file`, if given. Loads the results of an earlier run with the same
    /// `command` and `question`; `question` contains all inputs that determine the results. Rejects a file with the
    /// results of another question. The work ends once `interrupted` returns true.
    pub fn new(
        command: &str,
        question: &str,
        file: Option<&Path>,
        interrupted: impl Fn() -> bool + Send + Sync + 'static,
    ) -> Result<Self, Failure> {
        let mut checkpoint = Checkpoint {
            version: env!("CARGO_PKG_VERSION").into(),
            command: command.into(),
            question: question.into(),
            stages: BTreeMap::new(),
        };
        if let Some(path) = file {
            if let Some(earlier) = read_checkpoint(path)? {
                if earlier.matches(&checkpoint) {
                    checkpoint = earlier;
                } else if !earlier.stages.is_empty() {
                    let reason = format!(
                        "{} holds results of `haptic {}` {} with another device file or other options",
                        path.display(),
                        earlier.command,
                        earlier.version
                    );
                    return Err(Failure::wrong(reason)
                        .remedy("delete the file, or name another")
                        .choose(Choice::ResultsFile));
                }
            }
            // Writes now, so that an error is reported before the work.
            write(path, &checkpoint)?;
        }
        let display = if std::io::stderr().is_terminal() { Display::InPlace } else { Display::Never };
        let state = Mutex::new(State { checkpoint, due: Instant::now() + WRITE_INTERVAL });
        Ok(Self { interrupted: Box::new(interrupted), file: file.map(Path::to_path_buf), display, state })
    }

    /// Creates a sweep that cannot be interrupted and that displays and stores nothing.
    #[must_use]
    pub fn quiet() -> Self {
        let state = Mutex::new(State { checkpoint: Checkpoint::default(), due: Instant::now() });
        Self { interrupted: Box::new(|| false), file: None, display: Display::Never, state }
    }

    /// Prints progress lines if standard error is not a terminal.
    #[must_use]
    pub fn in_lines(mut self) -> Self {
        if self.display == Display::Never && std::env::var_os(QUIET_VARIABLE).is_none() {
            self.display = Display::Lines;
        }
        self
    }

    /// Returns an error if the user has interrupted the work. Call it repeatedly in long computations.
    pub fn check_interrupted(&self) -> Result<(), Failure> {
        if (self.interrupted)() { Err(self.interrupted_failure("interrupted".into())) } else { Ok(()) }
    }

    /// Displays the name of a stage while work runs that is not divided into items.
    pub fn run_stage<R>(&self, stage: &str, work: impl FnOnce() -> R) -> R {
        match self.display {
            Display::InPlace => haptic_host::error::overwrite_line(format_args!("{stage}"), false),
            Display::Lines => haptic_host::error::say(format_args!("{stage}\n")),
            Display::Never => {}
        }
        let done = work();
        if self.display == Display::InPlace {
            haptic_host::error::overwrite_line(format_args!(""), true);
        }
        done
    }

    fn interrupted_failure(&self, how: String) -> Failure {
        let failure = Failure::impossible(how);
        match &self.file {
            Some(file) => failure.remedy(format!("the same command continues with the results in {}", file.display())),
            None => failure.remedy("keep results in a file, and the same command continues"),
        }
        .choose(Choice::ResultsFile)
    }

    fn show(&self, stage: &str, done: usize, of: usize) {
        match self.display {
            Display::InPlace if of > 1 => {
                haptic_host::error::overwrite_line(format_args!("{stage}: {done} of {of}"), done == of);
            }
            // Stages with many items print a line for each quarter.
            Display::Lines if done == of || of >= LONG_STAGE_ITEMS && done * 4 / of > (done - 1) * 4 / of => {
                haptic_host::error::say(format_args!("{stage}: {done} of {of}\n"));
            }
            _ => {}
        }
    }

    /// Applies `work` to items without a stored result of this `stage`. Returns the failure of the first failed item.
    pub fn map<T: Sync, R: Serialize + DeserializeOwned + Send>(
        &self,
        stage: &str,
        items: &[T],
        work: impl Fn(&T) -> Result<R, Failure> + Sync,
    ) -> Result<Vec<R>, Failure> {
        let mut results = self.begin::<R>(stage, items.len())?;
        let missing: Vec<usize> = (0..items.len()).filter(|index| !results.contains_key(index)).collect();
        let before = results.len();
        let progress = |done: usize, _: usize| {
            // After an interruption count skipped items too, because only a complete count clears the line in place.
            if self.display == Display::InPlace || !(self.interrupted)() {
                self.show(stage, before + done, items.len());
            }
        };
        let failing = AtomicUsize::new(usize::MAX);
        let done = crate::cores::map(&missing, &progress, |&index| {
            if (self.interrupted)() || failing.load(Ordering::Relaxed) < index {
                return None;
            }
            let result = work(&items[index]);
            // The result of an interrupted item is invalid.
            if (self.interrupted)() {
                return None;
            }
            let result = result.and_then(|result| self.keep(stage, index, &result).map(|()| result));
            if result.is_err() {
                failing.fetch_min(index, Ordering::Relaxed);
            }
            Some(result)
        });
        for (index, result) in missing.into_iter().zip(done) {
            match result {
                Some(Ok(result)) => drop(results.insert(index, result)),
                Some(Err(failure)) => {
                    self.save()?;
                    return Err(failure);
                }
                None => {}
            }
        }
        if results.len() == items.len() {
            return Ok(results.into_values().collect());
        }
        self.save()?;
        Err(self.interrupted_failure(format!("interrupted with {} of {} done ({stage})", results.len(), items.len())))
    }

    /// Removes the stored results; call it after printing the final result.
    pub fn finish(self) {
        if let Some(file) = self.file {
            // Ignores the error because the file may already be removed.
            let _ = std::fs::remove_file(file);
        }
    }

    /// Begins a stage and returns its stored results.
    fn begin<R: DeserializeOwned>(&self, stage: &str, of: usize) -> Result<BTreeMap<usize, R>, Failure> {
        let Some(file) = &self.file else { return Ok(BTreeMap::new()) };
        let mut state = self.lock();
        let stored = state.checkpoint.stages.entry(stage.into()).or_insert_with(|| Stage { of, done: BTreeMap::new() });
        let read = |(index, text): (&usize, &String)| Some((*index, read(text).filter(|_| *index < of)?));
        let results: Option<BTreeMap<usize, R>> = stored.done.iter().map(read).collect();
        results
            .filter(|_| stored.of == of)
            .ok_or_else(|| damaged_file(file, &format!("its results of stage \"{stage}\" do not fit")))
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(|held| held.into_inner())
    }

    fn keep<R: Serialize + DeserializeOwned>(&self, stage: &str, index: usize, result: &R) -> Result<(), Failure> {
        let Some(file) = &self.file else { return Ok(()) };
        let bytes = postcard::to_allocvec(result).map_err(Failure::impossible)?;
        // Rejects types that do not read back equal, because a resumed run would use other values.
        let back = postcard::take_from_bytes::<R>(&bytes).ok().filter(|(_, rest)| rest.is_empty());
        if back.and_then(|(back, _)| postcard::to_allocvec(&back).ok()).as_ref() != Some(&bytes) {
            return Err(Failure::impossible(format!(
                "a result of stage \"{stage}\" does not read back as it was stored"
            ))
            .remedy("do not store results, and report this error")
            .choose(Choice::ResultsFile));
        }
        let text = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        let mut state = self.lock();
        state.checkpoint.stages.entry(stage.into()).or_default().done.insert(index, text);
        if Instant::now() > state.due {
            let begun = Instant::now();
            // Ignores a write error, which is reported when the work is interrupted.
            let _ = write(file, &state.checkpoint);
            state.due = Instant::now() + WRITE_INTERVAL.max(begun.elapsed() * MIN_PAUSE_FACTOR);
        }
        Ok(())
    }

    fn save(&self) -> Result<(), Failure> {
        self.file.as_ref().map_or(Ok(()), |file| write(file, &self.lock().checkpoint))
    }
}

fn write(file: &Path, checkpoint: &Checkpoint) -> Result<(), Failure> {
    output::write(file, &serde_json::to_vec(checkpoint).map_err(Failure::impossible)?, Overwrite::Replace)
}

fn read_checkpoint(file: &Path) -> Result<Option<Checkpoint>, Failure> {
    match haptic_host::input::read_any_size(file) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(error) => Err(Failure::impossible(format!("{} cannot be read: {error}", file.display()))),
        Ok(bytes) => serde_json::from_slice(&bytes).map(Some).map_err(|error| damaged_file(file, &error)),
    }
}

fn damaged_file(file: &Path, why: &dyn std::fmt::Display) -> Failure {
    Failure::wrong(format!("{} is not a results file: {why}", file.display()))
        .remedy("name another file")
        .choose(Choice::ResultsFile)
}

/// Decodes a result from hex, or returns `None` if the text is invalid.
fn read<R: DeserializeOwned>(text: &str) -> Option<R> {
    let digits = |at: usize| u8::from_str_radix(text.get(at..at + 2)?, 16).ok();
    let bytes: Option<Vec<u8>> = (0..text.len()).step_by(2).map(digits).collect();
    postcard::take_from_bytes(&bytes?).ok().filter(|(_, rest)| rest.is_empty()).map(|(result, _)| result)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    /// A folder for the checkpoint, and the number of computed items.
    struct Case {
        folder: tempfile::TempDir,
        worked: Arc<AtomicUsize>,
    }

    impl Case {
        fn new() -> Self {
            Self { folder: tempfile::tempdir().unwrap(), worked: Arc::default() }
        }

        fn file(&self) -> PathBuf {
            self.folder.path().join("kept.json")
        }

        fn sweep(&self, question: &str, most: usize) -> Result<Sweep, Failure> {
            let worked = self.worked.clone();
            Sweep::new("tune", question, Some(&self.file()), move || worked.load(Ordering::SeqCst) >= most)
        }
    }

    fn items() -> Vec<f64> {
        (0..200).map(|i| 0.1 + f64::from(i) / 7.0).collect()
    }

    /// Returns numbers that need all digits, and values that are not finite.
    fn work(x: &f64) -> (Vec<f64>, Option<f64>) {
        let odd = f64::from_bits(f64::NAN.to_bits() ^ 0x8000_0000_0000_0001);
        (vec![x.sin(), 1.0 / x, x * 1e-300, f64::NEG_INFINITY, -0.0, odd], (*x > 9.0).then(|| x.sqrt()))
    }

    fn bits(all: &[(Vec<f64>, Option<f64>)]) -> Vec<u64> {
        all.iter().flat_map(|(some, one)| some.iter().chain(one)).map(|x| x.to_bits()).collect()
    }

    #[test]
    fn interrupted_work_resumes_with_identical_numbers() {
        let case = Case::new();
        let whole = Sweep::quiet().map("stage", &items(), |x| Ok(work(x))).unwrap();
        let run = |sweep: &Sweep| {
            sweep.map("stage", &items(), |x| {
                case.worked.fetch_add(1, Ordering::SeqCst);
                Ok(work(x))
            })
        };
        let failure = run(&case.sweep("question", 50).unwrap()).unwrap_err().to_string();
        assert!(
            failure.contains("of 200 done (stage)") && failure.contains("continues with the results in "),
            "{failure}"
        );
        let before = case.worked.load(Ordering::SeqCst);
        assert!(before < 60, "{before} items were started despite the interruption");
        let again = case.sweep("question", usize::MAX).unwrap();
        let stored = again.lock().checkpoint.stages["stage"].done.len();
        assert!(stored > 40, "{stored} results were stored");
        assert_eq!(bits(&run(&again).unwrap()), bits(&whole));
        assert_eq!(case.worked.load(Ordering::SeqCst), before + 200 - stored, "stored results were computed again");
        assert!(case.file().exists());
        again.finish();
        assert!(!case.file().exists());
    }

    #[test]
    fn checkpoints_of_other_questions_or_damaged_ones_are_rejected() {
        let case = Case::new();
        // A file without results does not block another question.
        drop(case.sweep("one", usize::MAX).unwrap());
        let sweep = case.sweep("two", usize::MAX).unwrap();
        sweep.map("stage", &items(), |x| Ok(work(x))).unwrap();
        sweep.save().unwrap();
        let refused = case.sweep("one", usize::MAX).err().unwrap().to_string();
        assert!(
            refused.contains("kept.json holds results of `haptic tune`") && refused.contains("delete"),
            "{refused}"
        );

        let text = std::fs::read_to_string(case.file()).unwrap();
        let others = |of: usize| case.sweep("two", usize::MAX).unwrap().map("stage", &items()[..of], |x| Ok(work(x)));
        assert_eq!(others(200).unwrap().len(), 200);
        assert!(others(100).unwrap_err().to_string().contains("do not fit"));
        let hex = text.find("\":\"06").unwrap();
        std::fs::write(case.file(), format!("{}07{}", &text[..hex + 3], &text[hex + 5..])).unwrap();
        assert!(others(200).unwrap_err().to_string().contains("do not fit"));
        std::fs::write(case.file(), &text[..text.len() / 2]).unwrap();
        assert!(case.sweep("two", usize::MAX).err().unwrap().to_string().contains("is not a results file"));
        let nowhere = case.folder.path().join("no/kept.json");
        let refused = Sweep::new("tune", "", Some(&nowhere), || false).err().unwrap().to_string();
        assert!(refused.contains("make the folder first"), "{refused}");
    }

    #[test]
    fn the_first_failing_item_is_reported_and_results_stay() {
        let case = Case::new();
        let items: Vec<usize> = (0..64).collect();
        for _ in 0..20 {
            let failure = Sweep::quiet().map("stage", &items, |item| match item % 8 {
                5 => Err::<u8, _>(Failure::wrong(item)),
                _ => Ok(0),
            });
            assert_eq!(failure.unwrap_err().to_string(), "5");
        }
        let sweep = case.sweep("question", usize::MAX).unwrap();
        sweep.map("stage", &items, |item| if *item < 9 { Ok(0) } else { Err(Failure::wrong("no")) }).unwrap_err();
        assert_eq!(case.sweep("question", usize::MAX).unwrap().lock().checkpoint.stages["stage"].done.len(), 9);
    }

    #[test]
    fn results_that_do_not_round_trip_are_rejected() {
        #[derive(Debug, Serialize, Deserialize)]
        struct OptionalOut {
            #[serde(skip_serializing_if = "Option::is_none", default)]
            out: Option<u8>,
        }
        let case = Case::new();
        let sweep = case.sweep("question", usize::MAX).unwrap();
        let failure = sweep.map("stage", &[None, Some(1_u8)], |out| Ok(OptionalOut { out: *out })).unwrap_err();
        assert!(failure.to_string().contains("does not read back as it was stored"), "{failure}");
    }
}
