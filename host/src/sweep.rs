//! Long work on many things, on all cores: it shows progress, ends in order at Ctrl-C, and goes on where it stopped.
//!
//! Results are in the order of the things whoever was first, and what was kept is what would be computed again, to the
//! bit. So an answer is the same on any number of cores, in any order, with any number of interruptions.

use crate::error::Failure;
use crate::interrupt::Interrupt;
use crate::output::{self, Overwrite};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// How often what is done is written down.
const OFTEN: Duration = Duration::from_secs(5);

/// What is kept between runs: the question, and of each stage the results that are there, in postcard's bytes as hex.
#[derive(Debug, Default, Deserialize, Serialize)]
struct Kept {
    question: String,
    stages: BTreeMap<String, BTreeMap<usize, String>>,
}

/// A long piece of work with its name for the question that it answers.
#[derive(Debug)]
pub struct Sweep {
    interrupt: Option<Interrupt>,
    file: Option<PathBuf>,
    shown: bool,
    kept: Mutex<(Kept, Instant)>,
}

impl Sweep {
    /// Keeps results in `file`, where one is given, and begins with those of an earlier run that asked the same
    /// `question`; one that holds those of another question is refused.
    pub fn new(question: &str, file: Option<&Path>, interrupt: Option<Interrupt>) -> Result<Self, Failure> {
        let mut kept = Kept { question: question.into(), ..Kept::default() };
        if let Some(path) = file.filter(|path| path.exists()) {
            let broken = |error: &dyn std::fmt::Display| {
                Failure::wrong(format!("{} is no progress of this command: {error}", path.display()))
                    .remedy("name another file with --progress")
            };
            let text = crate::input::read_to_string(path).map_err(|error| broken(&error))?;
            let found: Kept = serde_json::from_str(&text).map_err(|error| broken(&error))?;
            if found.question != question {
                return Err(broken(&format!("it belongs to `{}`", found.question)));
            }
            kept = found;
        }
        let shown = std::io::stderr().is_terminal();
        Ok(Self { interrupt, file: file.map(Path::to_path_buf), shown, kept: Mutex::new((kept, Instant::now())) })
    }

    /// One that nobody interrupts and that keeps nothing.
    #[must_use]
    pub fn quiet() -> Self {
        Self { interrupt: None, file: None, shown: false, kept: Mutex::new((Kept::default(), Instant::now())) }
    }

    /// `work` on each of `things`; what an earlier run has of this stage is not done again.
    pub fn map<T: Sync, R: Serialize + DeserializeOwned + Send>(
        &self,
        stage: &str,
        things: &[T],
        work: impl Fn(&T) -> R + Sync,
    ) -> Result<Vec<R>, Failure> {
        let earlier = self.lock().0.stages.get(stage).cloned().unwrap_or_default();
        let mut found: BTreeMap<usize, R> =
            earlier.iter().filter_map(|(index, text)| Some((*index, read(text)?))).collect();
        let missing: Vec<usize> = (0..things.len()).filter(|index| !found.contains_key(index)).collect();
        let progress = |done: usize, of: usize| {
            if self.shown && of > 1 {
                let end = if done == of { "\x1b[2K\r" } else { "" };
                crate::error::say(format_args!("\r{stage}: {done} of {of}{end}"));
            }
        };
        let done = crate::cores::map(&missing, &progress, |index| {
            if self.interrupt.is_some_and(Interrupt::is_set) {
                return None;
            }
            let result = work(&things[*index]);
            // What was cut short is no result.
            if self.interrupt.is_some_and(Interrupt::is_set) {
                return None;
            }
            self.keep(stage, *index, &result);
            Some(result)
        });
        found.extend(missing.iter().zip(done).filter_map(|(index, result)| Some((*index, result?))));
        if found.len() == things.len() {
            return Ok(found.into_values().collect());
        }
        let (there, of) = (found.len(), things.len());
        let failure = Failure::impossible(format!("interrupted after {there} of {of} ({stage})"));
        let Some(file) = &self.file else {
            return Err(failure.remedy("with --progress FILE it could go on from there"));
        };
        self.write(&self.lock().0)?;
        Err(failure.remedy(format!("the same command goes on from {}", file.display())))
    }

    /// The work is done: nothing is kept any more.
    pub fn finish(self) {
        if let Some(file) = self.file {
            // One that was never written is not there.
            let _ = std::fs::remove_file(file);
        }
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, (Kept, Instant)> {
        self.kept.lock().unwrap_or_else(|held| held.into_inner())
    }

    fn keep<R: Serialize>(&self, stage: &str, index: usize, result: &R) {
        if self.file.is_none() {
            return;
        }
        let Ok(bytes) = postcard::to_allocvec(result) else { return };
        let text = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        let mut kept = self.lock();
        kept.0.stages.entry(stage.into()).or_default().insert(index, text);
        if kept.1.elapsed() > OFTEN {
            // What cannot be written now is said when the work is interrupted.
            let _ = self.write(&kept.0);
            kept.1 = Instant::now();
        }
    }

    fn write(&self, kept: &Kept) -> Result<(), Failure> {
        let Some(file) = &self.file else { return Ok(()) };
        let text = serde_json::to_string(kept).map_err(Failure::impossible)?;
        output::write(file, text.as_bytes(), Overwrite::Replace)
    }
}

/// A result from its hex; none from text that is not one.
fn read<R: DeserializeOwned>(text: &str) -> Option<R> {
    let digits = |at: usize| u8::from_str_radix(text.get(at..at + 2)?, 16).ok();
    let bytes: Option<Vec<u8>> = (0..text.len()).step_by(2).map(digits).collect();
    postcard::from_bytes(&bytes?).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    #[test]
    fn work_goes_on_where_it_stopped_with_the_same_numbers_to_the_bit() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("progress.json");
        let things: Vec<f64> = (0..50).map(|i| 0.1 + f64::from(i) / 7.0).collect();
        let work = |x: &f64| vec![x.sin(), 1.0 / x, x * 1e-300];
        let whole = Sweep::quiet().map("stage", &things, work).unwrap();

        // Cut short after twenty: what is there is written, as Ctrl-C does.
        let cut = Sweep::new("question", Some(&file), None).unwrap();
        cut.map("stage", &things[..20], work).unwrap();
        cut.write(&cut.lock().0).unwrap();
        let done = AtomicUsize::new(0);
        let again = Sweep::new("question", Some(&file), None).unwrap();
        let rest = again
            .map("stage", &things, |x| {
                done.fetch_add(1, Ordering::Relaxed);
                work(x)
            })
            .unwrap();
        assert_eq!(done.into_inner(), 30, "what was there was done again");
        let bits = |all: &[Vec<f64>]| all.iter().flatten().map(|x| x.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&rest), bits(&whole));
        assert!(Sweep::new("another", Some(&file), None).unwrap_err().to_string().contains("it belongs to `question`"));
        again.finish();
        assert!(!file.exists());
    }
}
