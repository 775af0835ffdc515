//! Long work on many things, on all cores: it shows progress, ends in order at Ctrl-C, and goes on where it stopped.
//! On a terminal progress is one line that changes; elsewhere those that take minutes print a line for each stage.
//!
//! Results are in the order of the things whoever was first, and what was kept is what would be computed again, to the
//! bit. So an answer is the same on any number of cores, in any order, with any number of interruptions.

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

/// Results are written down this often, so a crash costs no more than that,
const WRITE_INTERVAL: Duration = Duration::from_secs(2);
/// but after a pause of at least this many times as long as the last writing took.
const LEAST_PAUSE: u32 = 20;

/// Stages of so many things are told in quarters.
const LONG_STAGE: usize = 16;

/// The state that is kept between runs.
#[derive(Debug, Default, Deserialize, Serialize)]
struct Checkpoint {
    /// The tool's version: another one may come to other numbers.
    version: String,
    /// The command.
    command: String,
    /// Everything that decides the results.
    question: String,
    stages: BTreeMap<String, Stage>,
}

/// One round of work.
#[derive(Debug, Default, Deserialize, Serialize)]
struct Stage {
    /// Number of things to work on.
    of: usize,
    /// Results by their thing's place, in postcard's bytes as hex: decimals would lose what is not finite.
    done: BTreeMap<usize, String>,
}

impl Checkpoint {
    /// Returns true if both belong to the same question.
    fn is_of(&self, other: &Self) -> bool {
        (&self.version, &self.command, &self.question) == (&other.version, &other.command, &other.question)
    }
}

/// A long piece of work with the question that it answers.
pub struct Sweep {
    interrupted: Box<dyn Fn() -> bool + Send + Sync>,
    file: Option<PathBuf>,
    shown: Shown,
    state: Mutex<State>,
}

/// The way in which progress is shown.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Shown {
    Never,
    InPlace,
    Lines,
}

/// A program that shows what its commands say on standard error sets this, so that they say nothing of progress.
pub const QUIET: &str = "HAPTIC_NO_PROGRESS";

struct State {
    kept: Checkpoint,
    /// When it is to be written again.
    due: Instant,
}

impl Sweep {
    /// Keeps results in `file`, where one is given, and begins with those of an earlier run of the same `command` with
    /// the same `question`, which is everything that decides the results; a file with those of another one is refused.
    /// Once `interrupted` says so, the work ends in order.
    pub fn new(
        command: &str,
        question: &str,
        file: Option<&Path>,
        interrupted: impl Fn() -> bool + Send + Sync + 'static,
    ) -> Result<Self, Failure> {
        let mut kept = Checkpoint {
            version: env!("CARGO_PKG_VERSION").into(),
            command: command.into(),
            question: question.into(),
            stages: BTreeMap::new(),
        };
        if let Some(path) = file {
            if let Some(found) = earlier(path)? {
                if found.is_of(&kept) {
                    kept = found;
                } else if !found.stages.is_empty() {
                    let reason = format!(
                        "{} holds results of `haptic {}` {} with another device file or other options",
                        path.display(),
                        found.command,
                        found.version
                    );
                    return Err(Failure::wrong(reason).remedy("delete it, or name another file").choose(Choice::Kept));
                }
            }
            // A place that cannot be written is told before the work, not after it.
            write(path, &kept)?;
        }
        let shown = if std::io::stderr().is_terminal() { Shown::InPlace } else { Shown::Never };
        let state = Mutex::new(State { kept, due: Instant::now() + WRITE_INTERVAL });
        Ok(Self { interrupted: Box::new(interrupted), file: file.map(Path::to_path_buf), shown, state })
    }

    /// A sweep that cannot be interrupted and neither shows nor keeps anything.
    #[must_use]
    pub fn quiet() -> Self {
        let state = Mutex::new(State { kept: Checkpoint::default(), due: Instant::now() });
        Self { interrupted: Box::new(|| false), file: None, shown: Shown::Never, state }
    }

    /// The same with a line for each stage where standard error is no terminal.
    #[must_use]
    pub fn in_lines(mut self) -> Self {
        if self.shown == Shown::Never && std::env::var_os(QUIET).is_none() {
            self.shown = Shown::Lines;
        }
        self
    }

    /// An error once the user has asked for the end: for work that takes longer than a moment.
    pub fn go_on(&self) -> Result<(), Failure> {
        if (self.interrupted)() { Err(self.ended("interrupted".into())) } else { Ok(()) }
    }

    /// Tells of work that is not done in parts.
    pub fn during<R>(&self, stage: &str, work: impl FnOnce() -> R) -> R {
        match self.shown {
            Shown::InPlace => haptic_host::error::say_over(format_args!("{stage}"), false),
            Shown::Lines => haptic_host::error::say(format_args!("{stage}\n")),
            Shown::Never => {}
        }
        let done = work();
        if self.shown == Shown::InPlace {
            haptic_host::error::say_over(format_args!(""), true);
        }
        done
    }

    fn ended(&self, how: String) -> Failure {
        let failure = Failure::impossible(how);
        match &self.file {
            Some(file) => failure.remedy(format!("the same command goes on from there, out of {}", file.display())),
            None => failure.remedy("with a file that keeps results the same command would go on from there"),
        }
        .choose(Choice::Kept)
    }

    fn show(&self, stage: &str, done: usize, of: usize) {
        match self.shown {
            Shown::InPlace if of > 1 => {
                haptic_host::error::say_over(format_args!("{stage}: {done} of {of}"), done == of);
            }
            // Of many things every quarter.
            Shown::Lines if done == of || of >= LONG_STAGE && done * 4 / of > (done - 1) * 4 / of => {
                haptic_host::error::say(format_args!("{stage}: {done} of {of}\n"));
            }
            _ => {}
        }
    }

    /// `work` on each of `things`; what an earlier run has of this `stage`, a name of its own, is not done again. Of
    /// several that fail the first in the order of the things is told.
    pub fn map<T: Sync, R: Serialize + DeserializeOwned + Send>(
        &self,
        stage: &str,
        things: &[T],
        work: impl Fn(&T) -> Result<R, Failure> + Sync,
    ) -> Result<Vec<R>, Failure> {
        let mut found = self.begin::<R>(stage, things.len())?;
        let missing: Vec<usize> = (0..things.len()).filter(|index| !found.contains_key(index)).collect();
        let before = found.len();
        let progress = |done: usize, _: usize| {
            // Skipped things count as done once the user has asked for the end, which clears the line.
            if self.shown == Shown::InPlace || !(self.interrupted)() {
                self.show(stage, before + done, things.len());
            }
        };
        let failing = AtomicUsize::new(usize::MAX);
        let done = crate::cores::map(&missing, &progress, |&index| {
            if (self.interrupted)() || failing.load(Ordering::Relaxed) < index {
                return None;
            }
            let result = work(&things[index]);
            // A point that was cut short is no result.
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
                Some(Ok(result)) => drop(found.insert(index, result)),
                Some(Err(failure)) => {
                    self.save()?;
                    return Err(failure);
                }
                None => {}
            }
        }
        if found.len() == things.len() {
            return Ok(found.into_values().collect());
        }
        self.save()?;
        Err(self.ended(format!("interrupted with {} of {} done ({stage})", found.len(), things.len())))
    }

    /// The answer is there, and told: nothing is kept any more.
    pub fn finish(self) {
        if let Some(file) = self.file {
            // One that somebody has taken away is gone as well.
            let _ = std::fs::remove_file(file);
        }
    }

    /// The results that there are of a stage.
    fn begin<R: DeserializeOwned>(&self, stage: &str, of: usize) -> Result<BTreeMap<usize, R>, Failure> {
        let Some(file) = &self.file else { return Ok(BTreeMap::new()) };
        let mut state = self.lock();
        let kept = state.kept.stages.entry(stage.into()).or_insert_with(|| Stage { of, done: BTreeMap::new() });
        let read = |(index, text): (&usize, &String)| Some((*index, read(text).filter(|_| *index < of)?));
        let found: Option<BTreeMap<usize, R>> = kept.done.iter().map(read).collect();
        found
            .filter(|_| kept.of == of)
            .ok_or_else(|| damaged(file, &format!("its part \"{stage}\" is of another kind")))
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(|held| held.into_inner())
    }

    fn keep<R: Serialize + DeserializeOwned>(&self, stage: &str, index: usize, result: &R) -> Result<(), Failure> {
        let Some(file) = &self.file else { return Ok(()) };
        let bytes = postcard::to_allocvec(result).map_err(Failure::impossible)?;
        // A type that leaves fields out, or reads other things than it writes, would come back as something else.
        let back = postcard::take_from_bytes::<R>(&bytes).ok().filter(|(_, rest)| rest.is_empty());
        if back.and_then(|(back, _)| postcard::to_allocvec(&back).ok()).as_ref() != Some(&bytes) {
            return Err(Failure::impossible(format!("a result of \"{stage}\" cannot be kept as it is"))
                .remedy("keep no results, and report this")
                .choose(Choice::Kept));
        }
        let text = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        let mut state = self.lock();
        state.kept.stages.entry(stage.into()).or_default().done.insert(index, text);
        if Instant::now() > state.due {
            let begun = Instant::now();
            // A file that cannot be written now is told of when the work is interrupted.
            let _ = write(file, &state.kept);
            state.due = Instant::now() + WRITE_INTERVAL.max(begun.elapsed() * LEAST_PAUSE);
        }
        Ok(())
    }

    fn save(&self) -> Result<(), Failure> {
        self.file.as_ref().map_or(Ok(()), |file| write(file, &self.lock().kept))
    }
}

fn write(file: &Path, kept: &Checkpoint) -> Result<(), Failure> {
    output::write(file, &serde_json::to_vec(kept).map_err(Failure::impossible)?, Overwrite::Replace)
}

/// The state that an earlier run has left.
fn earlier(file: &Path) -> Result<Option<Checkpoint>, Failure> {
    match haptic_host::input::read_own(file) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(error) => Err(Failure::impossible(format!("{} cannot be read: {error}", file.display()))),
        Ok(bytes) => serde_json::from_slice(&bytes).map(Some).map_err(|error| damaged(file, &error)),
    }
}

fn damaged(file: &Path, why: &dyn std::fmt::Display) -> Failure {
    Failure::wrong(format!("{} is not what a search keeps: {why}", file.display()))
        .remedy("name another file")
        .choose(Choice::Kept)
}

/// A result from its hex; none from text that is not one.
fn read<R: DeserializeOwned>(text: &str) -> Option<R> {
    let digits = |at: usize| u8::from_str_radix(text.get(at..at + 2)?, 16).ok();
    let bytes: Option<Vec<u8>> = (0..text.len()).step_by(2).map(digits).collect();
    postcard::take_from_bytes(&bytes?).ok().filter(|(_, rest)| rest.is_empty()).map(|(result, _)| result)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    /// A sweep that is interrupted after so many results.
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

    fn things() -> Vec<f64> {
        (0..200).map(|i| 0.1 + f64::from(i) / 7.0).collect()
    }

    /// Numbers that take all digits, and some that have none.
    fn work(x: &f64) -> (Vec<f64>, Option<f64>) {
        let odd = f64::from_bits(f64::NAN.to_bits() ^ 0x8000_0000_0000_0001);
        (vec![x.sin(), 1.0 / x, x * 1e-300, f64::NEG_INFINITY, -0.0, odd], (*x > 9.0).then(|| x.sqrt()))
    }

    fn bits(all: &[(Vec<f64>, Option<f64>)]) -> Vec<u64> {
        all.iter().flat_map(|(some, one)| some.iter().chain(one)).map(|x| x.to_bits()).collect()
    }

    #[test]
    fn work_goes_on_where_it_stopped_with_the_same_numbers_to_the_bit() {
        let case = Case::new();
        let whole = Sweep::quiet().map("stage", &things(), |x| Ok(work(x))).unwrap();
        let run = |sweep: &Sweep| {
            sweep.map("stage", &things(), |x| {
                case.worked.fetch_add(1, Ordering::SeqCst);
                Ok(work(x))
            })
        };
        let failure = run(&case.sweep("question", 50).unwrap()).unwrap_err().to_string();
        assert!(failure.contains("of 200 done (stage)") && failure.contains("out of "), "{failure}");
        let before = case.worked.load(Ordering::SeqCst);
        assert!(before < 60, "{before} were begun after the interruption");
        let again = case.sweep("question", usize::MAX).unwrap();
        let kept = again.lock().kept.stages["stage"].done.len();
        assert!(kept > 40, "{kept} were kept");
        assert_eq!(bits(&run(&again).unwrap()), bits(&whole));
        assert_eq!(case.worked.load(Ordering::SeqCst), before + 200 - kept, "what was there was done again");
        assert!(case.file().exists());
        again.finish();
        assert!(!case.file().exists());
    }

    #[test]
    fn what_belongs_to_another_question_or_is_damaged_is_refused() {
        let case = Case::new();
        // A file without results does not block another question.
        drop(case.sweep("one", usize::MAX).unwrap());
        let sweep = case.sweep("two", usize::MAX).unwrap();
        sweep.map("stage", &things(), |x| Ok(work(x))).unwrap();
        sweep.save().unwrap();
        let refused = case.sweep("one", usize::MAX).err().unwrap().to_string();
        assert!(
            refused.contains("kept.json holds results of `haptic tune`") && refused.contains("delete"),
            "{refused}"
        );

        let text = std::fs::read_to_string(case.file()).unwrap();
        let others = |of: usize| case.sweep("two", usize::MAX).unwrap().map("stage", &things()[..of], |x| Ok(work(x)));
        assert_eq!(others(200).unwrap().len(), 200);
        assert!(others(100).unwrap_err().to_string().contains("is of another kind"));
        let hex = text.find("\":\"06").unwrap();
        std::fs::write(case.file(), format!("{}07{}", &text[..hex + 3], &text[hex + 5..])).unwrap();
        assert!(others(200).unwrap_err().to_string().contains("is of another kind"));
        std::fs::write(case.file(), &text[..text.len() / 2]).unwrap();
        assert!(case.sweep("two", usize::MAX).err().unwrap().to_string().contains("is not what a search keeps"));
        let nowhere = case.folder.path().join("no/kept.json");
        let refused = Sweep::new("tune", "", Some(&nowhere), || false).err().unwrap().to_string();
        assert!(refused.contains("make the folder first"), "{refused}");
    }

    #[test]
    fn the_first_failure_in_the_order_of_the_things_is_told_and_what_is_done_stays() {
        let case = Case::new();
        let things: Vec<usize> = (0..64).collect();
        for _ in 0..20 {
            let failure = Sweep::quiet().map("stage", &things, |thing| match thing % 8 {
                5 => Err::<u8, _>(Failure::wrong(thing)),
                _ => Ok(0),
            });
            assert_eq!(failure.unwrap_err().to_string(), "5");
        }
        let sweep = case.sweep("question", usize::MAX).unwrap();
        sweep.map("stage", &things, |thing| if *thing < 9 { Ok(0) } else { Err(Failure::wrong("no")) }).unwrap_err();
        assert_eq!(case.sweep("question", usize::MAX).unwrap().lock().kept.stages["stage"].done.len(), 9);
    }

    #[test]
    fn a_result_that_would_not_come_back_is_not_kept() {
        #[derive(Debug, Serialize, Deserialize)]
        struct Leaves {
            #[serde(skip_serializing_if = "Option::is_none", default)]
            out: Option<u8>,
        }
        let case = Case::new();
        let sweep = case.sweep("question", usize::MAX).unwrap();
        let failure = sweep.map("stage", &[None, Some(1_u8)], |out| Ok(Leaves { out: *out })).unwrap_err();
        assert!(failure.to_string().contains("cannot be kept as it is"), "{failure}");
    }
}
