//! The pages that are open: what waits for each of them, and what they say.

use super::message::FromPage;
use std::collections::{BTreeMap, VecDeque};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Most pages at once.
pub const MOST_PAGES: usize = 16;
/// Most samples of sound that wait for a page; older ones are dropped.
const SOUND: usize = 16_384;

/// A page, by the number that it got when it came.
pub type PageId = u64;

/// What the stage hears of a page.
#[derive(Debug)]
pub enum Event {
    /// It connected.
    Came(PageId),
    /// It sent a message, or something that is not one: then the reason.
    Said(PageId, Result<FromPage, String>),
    /// It disconnected, for whatever reason.
    Gone(PageId),
}

/// What a page gets.
#[derive(Clone, Debug, PartialEq)]
pub enum Message {
    /// A JSON document.
    Text(String),
    /// Numbers, each four bytes: what they are, then a sweep ([`super::scope::Scope::bytes`]) or rate and sound.
    Bytes(Vec<u8>),
}

/// What waits for a page. Messages keep their order and none is lost; of pictures and scopes the newest counts.
#[derive(Debug, Default)]
pub struct Outbox {
    /// JSON documents.
    pub messages: VecDeque<String>,
    /// The newest picture, a JSON document.
    pub picture: Option<String>,
    /// The newest scope, as [`super::scope::Scope::bytes`] packs it.
    pub scope: Option<Vec<u8>>,
    /// Motor torque to listen to, N m, and its rate in Hz.
    pub sound: (f32, VecDeque<f32>),
}

impl Outbox {
    /// What is sent, in this order: JSON as text, numbers as bytes.
    pub fn messages(self) -> impl Iterator<Item = Message> {
        let texts = self.messages.into_iter().chain(self.picture).map(Message::Text);
        let (rate_hz, samples) = self.sound;
        let sound = (!samples.is_empty()).then(|| {
            let numbers = [2.0, rate_hz].into_iter().chain(samples);
            numbers.flat_map(f32::to_le_bytes).collect()
        });
        texts.chain(self.scope.into_iter().chain(sound).map(Message::Bytes))
    }

    /// Adds samples to listen to.
    pub fn hear(&mut self, rate_hz: f32, samples: &[f32]) {
        self.sound.0 = rate_hz;
        self.sound.1.extend(samples);
        let late = self.sound.1.len().saturating_sub(SOUND);
        self.sound.1.drain(..late);
    }
}

/// Where pages and stage meet.
#[derive(Clone, Debug)]
pub struct Hub {
    pages: Arc<Mutex<(PageId, BTreeMap<PageId, Outbox>)>>,
    events: Sender<Event>,
}

impl Hub {
    /// A hub, and where the stage hears what pages say.
    pub fn new() -> (Self, Receiver<Event>) {
        let (events, heard) = channel();
        (Self { pages: Arc::default(), events }, heard)
    }

    fn pages(&self) -> MutexGuard<'_, (PageId, BTreeMap<PageId, Outbox>)> {
        self.pages.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Lets a page in; `None` where there are too many.
    pub fn come(&self) -> Option<PageId> {
        let mut pages = self.pages();
        if pages.1.len() >= MOST_PAGES {
            return None;
        }
        pages.0 += 1;
        let id = pages.0;
        let named = format!(r#"{{"is":"you","you":{id}}}"#);
        pages.1.insert(id, Outbox { messages: [named].into(), ..Outbox::default() });
        self.tell(Event::Came(id));
        Some(id)
    }

    /// Forgets a page.
    pub fn go(&self, id: PageId) {
        self.pages().1.remove(&id);
        self.tell(Event::Gone(id));
    }

    /// Passes on what a page said.
    pub fn said(&self, id: PageId, message: Result<FromPage, String>) {
        self.tell(Event::Said(id, message));
    }

    fn tell(&self, event: Event) {
        // A stage that is gone hears nothing, and the process is about to end.
        let _ = self.events.send(event);
    }

    /// Takes what waits for a page.
    pub fn take(&self, id: PageId) -> Outbox {
        self.pages().1.get_mut(&id).map(std::mem::take).unwrap_or_default()
    }

    /// Does something to what waits for one page.
    pub fn to(&self, id: PageId, put: impl FnOnce(&mut Outbox)) {
        if let Some(outbox) = self.pages().1.get_mut(&id) {
            put(outbox);
        }
    }

    /// Does something to what waits for every page.
    pub fn to_all(&self, mut put: impl FnMut(&mut Outbox)) {
        self.pages().1.values_mut().for_each(&mut put);
    }

    /// How many pages are open.
    pub fn count(&self) -> usize {
        self.pages().1.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_that_is_late_sees_the_newest_picture_and_every_message() {
        let (hub, heard) = Hub::new();
        let page = hub.come().unwrap();
        for number in 0..3 {
            hub.to_all(|outbox| {
                outbox.picture = Some(number.to_string());
                outbox.messages.push_back(number.to_string());
            });
        }
        let waiting = hub.take(page);
        assert_eq!((waiting.picture.as_deref(), waiting.messages.len()), (Some("2"), 4));
        assert!(hub.take(page).picture.is_none());
        hub.go(page);
        assert!(matches!(heard.try_iter().collect::<Vec<_>>()[..], [Event::Came(1), Event::Gone(1)]));
    }

    #[test]
    fn pages_are_let_in_until_there_are_too_many() {
        let (hub, _heard) = Hub::new();
        let pages: Vec<_> = (0..=MOST_PAGES).map(|_| hub.come()).collect();
        assert!(pages[..MOST_PAGES].iter().all(Option::is_some) && pages[MOST_PAGES].is_none());
    }

    #[test]
    fn sound_that_nobody_fetched_is_dropped_from_its_beginning() {
        let mut outbox = Outbox::default();
        outbox.hear(1000.0, &vec![0.0; SOUND]);
        outbox.hear(1000.0, &[7.0]);
        assert_eq!((outbox.sound.1.len(), outbox.sound.1.back()), (SOUND, Some(&7.0)));
    }
}
