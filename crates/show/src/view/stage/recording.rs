//! Recordings that pages start and stop.

use super::Stage;
use crate::recorder::about::About;
use crate::recorder::{RecordError, RowWriter};
use crate::view::hub::PageId;
use haptic_host::link::{BoardError, Losses, Row};
use haptic_host::output::{self, Overwrite};
use serde::Serialize;
use serde_json::json;

pub(super) struct ActiveRecording {
    writer: RowWriter,
    rate_hz: f64,
    /// Control steps of the first and the newest row.
    steps: Option<(u32, u32)>,
    rows: u64,
    /// The board's losses at the start of the recording.
    before: Losses,
}

impl ActiveRecording {
    /// Returns the time of the newest row, s.
    fn time(&self) -> f64 {
        self.steps.map_or(0.0, |(first, newest)| f64::from(newest.wrapping_sub(first)) / self.rate_hz)
    }

    pub(super) fn add_row(&mut self, row: &Row) -> Result<(), RecordError> {
        let first = self.steps.map_or(row.step, |(first, _)| first);
        self.steps = Some((first, row.step));
        self.rows += 1;
        self.writer.add_row(row.step, self.time(), &row.values)
    }

    /// Writes an event at the time of the newest row.
    pub(super) fn add_event(&mut self, words: &str) -> Result<(), RecordError> {
        self.writer.add_event(self.time(), words)
    }

    pub(super) fn flush(&mut self) -> Result<(), RecordError> {
        self.writer.flush()
    }

    pub(super) fn status(&self) -> RecordingStatus {
        RecordingStatus { file: self.writer.destination(), rows: self.rows, bytes: self.writer.bytes() }
    }

    /// Ends the recording. Returns a summary.
    pub(super) fn end(mut self, now: Losses, is_cut: bool) -> Result<String, RecordError> {
        let losses = Losses {
            received: self.rows,
            missing: now.missing.saturating_sub(self.before.missing),
            dropped_by_board: now.dropped_by_board.saturating_sub(self.before.dropped_by_board),
            batches_lost: now.batches_lost.saturating_sub(self.before.batches_lost),
            garbled: now.garbled.saturating_sub(self.before.garbled),
        };
        let cut = if is_cut { "cut short: the board was lost; " } else { "" };
        self.writer.end(&format!("{cut}{losses}"), &losses)?;
        Ok(format!("recorded {}: {losses}", self.writer.destination()))
    }
}

#[derive(Serialize)]
pub(super) struct RecordingStatus {
    file: String,
    rows: u64,
    bytes: u64,
}

impl Stage {
    pub(super) fn start_recording(&mut self, id: PageId) -> Result<(), BoardError> {
        if self.recording.is_some() {
            self.refuse(id, "a recording is already active");
            return Ok(());
        }
        let Some(folder) = &self.folder else {
            self.refuse(id, "recording is not available here");
            return Ok(());
        };
        let name = format!("haptic-{}.mcap", output::date().replace(':', ""));
        let path = output::unused_path(&folder.join(name));
        let divider = self.divider;
        let writer = About::read(self.board(), divider).and_then(|about| {
            let writer = RowWriter::create(&path, &about, &self.columns, Overwrite::Never)?;
            Ok((writer, about.rate_hz))
        });
        match writer {
            Ok((writer, rate_hz)) => {
                let before = self.board().losses();
                self.recording = Some(ActiveRecording { writer, rate_hz, steps: None, rows: 0, before });
            }
            Err(failure) => self.refuse(id, &failure.to_string()),
        }
        Ok(())
    }

    pub(super) fn stop_recording(&mut self, is_cut: bool) {
        let losses = self.board().losses();
        match self.recording.take().map(|recording| recording.end(losses, is_cut)) {
            Some(Ok(words)) => self.send_to_all(&json!({"is": "recorded", "words": words})),
            Some(Err(error)) => self.recording_failed(error),
            None => {}
        }
    }

    /// Ends a recording that failed; its file keeps the rows in it.
    pub(super) fn recording_failed(&mut self, error: RecordError) {
        self.recording = None;
        if let RecordError::Failed(failure) = error {
            self.refuse_all(None, &format!("the recording has ended: {failure}"));
        }
    }
}
