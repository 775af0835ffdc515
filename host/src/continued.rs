//! Long sweeps: work on many things on all cores, that can be interrupted and continued. What is done is kept in a file by the
//! place of each thing, so the result is the same in any order of work and after any number of interruptions.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use haptic_bridge::checksum::crc32;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::error::Failure;
use crate::output::{self, Overwrite};

/// How often what is done is written, s: what a crash may cost.
const KEPT_EVERY: Duration = Duration::from_secs(2);

/// What is done of a sweep.
#[derive(Serialize, Deserialize)]
struct Done {
    /// Of what: everything that decides the results.
    sweep: String,
    /// How many there are.
    of: usize,
    /// Results by their thing's place. Each is a document by itself, so that its numbers come back to the bit.
    done: BTreeMap<usize, String>,
}

/// Where a sweep keeps what is done, and whether it is to end now.
pub struct Continued<'a> {
    /// The file.
    pub path: &'a Path,
    /// What the sweep is: anything that decides its results.
    pub sweep: &'a str,
    /// Whether to end in order.
    pub interrupted: &'a (dyn Fn() -> bool + Sync),
}

/// `work` on each of `things` on all cores, in their order; `progress` hears how many are done, of how many. With
/// `continued` what is done already is not done again, and an interruption is a [`Failure`] that says how to go on.
pub fn map<T: Sync, R: Send + Serialize + DeserializeOwned>(
    things: &[T],
    continued: Option<&Continued<'_>>,
    progress: &(dyn Fn(usize, usize) + Sync),
    work: impl Fn(&T) -> R + Sync,
) -> Result<Vec<R>, Failure> {
    let Some(continued) = continued else { return Ok(crate::cores::map(things, progress, work)) };
    let sweep = format!("{:08x}", crc32(continued.sweep.as_bytes()));
    let mut kept = match std::fs::read(continued.path) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            Done { sweep: sweep.clone(), of: things.len(), done: BTreeMap::new() }
        }
        Err(error) => return Err(output::refused(continued.path, &error)),
        Ok(bytes) => serde_json::from_slice(&bytes).map_err(|error| {
            let reason = format!("{}: not what a sweep keeps: {error}", continued.path.display());
            Failure::wrong(reason).remedy("name another file with --continue")
        })?,
    };
    if kept.sweep != sweep || kept.of != things.len() {
        let reason =
            format!("{}: of another sweep, with another device file or other options", continued.path.display());
        return Err(Failure::wrong(reason).remedy("name another file with --continue, or delete this one"));
    }
    kept.done.retain(|place, _| *place < things.len());
    let left: Vec<usize> = (0..things.len()).filter(|place| !kept.done.contains_key(place)).collect();
    let before = kept.done.len();
    let state = Mutex::new((kept, Instant::now(), None));
    let reached = AtomicUsize::new(before);
    crate::cores::map(&left, &|_, _| {}, |&place| {
        if (continued.interrupted)() {
            return;
        }
        let result = serde_json::to_string(&work(&things[place]));
        let mut state = state.lock().unwrap_or_else(|held| held.into_inner());
        let (kept, saved, failed) = &mut *state;
        match result {
            Ok(text) => drop(kept.done.insert(place, text)),
            Err(error) => *failed = Some(Failure::impossible(error)),
        }
        if saved.elapsed() > KEPT_EVERY {
            *saved = Instant::now();
            *failed = failed.take().or(keep(continued.path, kept).err());
        }
        drop(state);
        progress(reached.fetch_add(1, Ordering::Relaxed) + 1, things.len());
    });
    let (kept, _, failed) = state.into_inner().unwrap_or_else(|held| held.into_inner());
    keep(continued.path, &kept)?;
    if let Some(failed) = failed {
        return Err(failed);
    }
    if kept.done.len() < things.len() {
        let reason = format!("interrupted with {} of {} done", kept.done.len(), things.len());
        let remedy = format!("the same command goes on from there, with --continue {}", continued.path.display());
        return Err(Failure::impossible(reason).remedy(remedy));
    }
    kept.done.into_values().map(|text| serde_json::from_str(&text).map_err(Failure::impossible)).collect()
}

fn keep(path: &Path, kept: &Done) -> Result<(), Failure> {
    output::write(path, &serde_json::to_vec(kept).map_err(Failure::impossible)?, Overwrite::Replace)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_interrupted_sweep_goes_on_and_comes_to_the_same() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sweep.json");
        let things: Vec<u32> = (1..=200).collect();
        // Numbers whose decimal form is long, and none.
        let work =
            |thing: &u32| (f64::from(*thing).sqrt().sin(), thing.is_multiple_of(3).then_some(1.0 / f64::from(*thing)));
        let whole = map(&things, None, &|_, _| {}, work).unwrap();
        let worked = AtomicUsize::new(0);
        let counted = |thing: &u32| {
            worked.fetch_add(1, Ordering::Relaxed);
            work(thing)
        };
        let run = |sweep: &str, most: usize| {
            let interrupted = || worked.load(Ordering::Relaxed) >= most;
            map(&things, Some(&Continued { path: &path, sweep, interrupted: &interrupted }), &|_, _| {}, counted)
        };
        let failure = run("a", 50).unwrap_err().to_string();
        assert!(failure.contains("interrupted with") && failure.contains("--continue"), "{failure}");
        assert_eq!(run("a", usize::MAX).unwrap(), whole);
        assert_eq!(worked.load(Ordering::Relaxed), things.len(), "nothing is done twice");
        assert_eq!(run("a", usize::MAX).unwrap(), whole);
        assert_eq!(worked.load(Ordering::Relaxed), things.len());
        assert!(run("b", usize::MAX).unwrap_err().to_string().contains("of another sweep"));
    }
}
