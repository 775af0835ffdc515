//! Work that is the same on many things, on all cores: the results are in the order of the things, whoever was first.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc;

/// `work` on each of `things`; `progress` hears how many are done, of how many, from any thread.
pub fn map<T: Sync, R: Send>(
    things: &[T],
    progress: &(dyn Fn(usize, usize) + Sync),
    work: impl Fn(&T) -> R + Sync,
) -> Vec<R> {
    let cores = std::thread::available_parallelism().map_or(1, usize::from).min(things.len());
    let (next, done) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let (send, receive) = mpsc::channel();
    std::thread::scope(|scope| {
        for _ in 0..cores {
            let send = send.clone();
            let (next, done, work) = (&next, &done, &work);
            scope.spawn(move || {
                while let Some((index, thing)) = {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    things.get(index).map(|thing| (index, thing))
                } {
                    // The receiver lives as long as this scope.
                    let _ = send.send((index, work(thing)));
                    progress(done.fetch_add(1, Ordering::Relaxed) + 1, things.len());
                }
            });
        }
    });
    drop(send);
    let mut found: Vec<(usize, R)> = receive.into_iter().collect();
    found.sort_by_key(|(index, _)| *index);
    found.into_iter().map(|(_, result)| result).collect()
}
