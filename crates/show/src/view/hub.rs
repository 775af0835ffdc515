//! The open pages, with the queues of their outgoing and incoming messages.
//!
//! A page uses bounded memory and delays no other page: full queues drop their oldest messages. Messages that turn
//! motors off have priority: [`Hub::next`] returns them before all others.

use super::message::FromPage;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Maximum number of pages at once.
pub const MAX_PAGES: usize = 16;
const MAX_INCOMING_MESSAGES: usize = 64;
/// Maximum number of documents queued for one page, pictures not counted.
const MAX_OUTGOING_DOCUMENTS: usize = 256;
/// Maximum number of sound samples queued for a page; older samples are dropped.
const MAX_SOUND_SAMPLES: usize = 16_384;

/// Number of a page, in the order of connection.
pub type PageId = u64;

/// An event of a page, for the stage.
#[derive(Debug, PartialEq)]
pub enum Event {
    /// The page connected.
    Connected(PageId),
    /// The page sent a message, or an invalid message with the reason.
    Received(PageId, Result<FromPage, String>),
    /// This number of the page's messages was dropped, because they arrived too fast.
    Dropped(PageId, u64),
    /// The page disconnected, for any reason.
    Disconnected(PageId),
}

/// A message to a page.
#[derive(Clone, Debug, PartialEq)]
pub enum Message {
    /// A JSON document.
    Text(String),
    /// Little-endian `f32`: the kind, then a sweep ([`super::scope::Scope::encode`]), or rate and sound.
    Bytes(Vec<u8>),
}

/// The outgoing queue of a page. Messages keep their order, and the oldest are dropped if the page reads too slowly;
/// only the newest picture and scope are kept.
#[derive(Debug, Default)]
pub struct Outbox {
    /// JSON documents in sending order.
    pub messages: VecDeque<String>,
    /// Newest picture, a JSON document.
    pub picture: Option<String>,
    /// Newest sweep of the oscilloscope, encoded by [`super::scope::Scope::encode`].
    pub scope: Option<Vec<u8>>,
    /// Rate in Hz and samples of motor torque (N m), for the sound.
    pub sound: (f32, VecDeque<f32>),
}

impl Outbox {
    /// Returns the messages in sending order: JSON as text, numbers as bytes.
    pub fn messages(self) -> impl Iterator<Item = Message> {
        let texts = self.messages.into_iter().chain(self.picture).map(Message::Text);
        let (rate_hz, samples) = self.sound;
        let sound = (!samples.is_empty()).then(|| {
            let numbers = [2.0, rate_hz].into_iter().chain(samples);
            numbers.flat_map(f32::to_le_bytes).collect()
        });
        texts.chain(self.scope.into_iter().chain(sound).map(Message::Bytes))
    }

    /// Adds a JSON document.
    pub fn queue_document(&mut self, document: String) {
        if self.messages.len() >= MAX_OUTGOING_DOCUMENTS {
            self.messages.pop_front();
        }
        self.messages.push_back(document);
    }

    /// Adds samples of motor torque for the sound.
    pub fn queue_sound(&mut self, rate_hz: f32, samples: &[f32]) {
        self.sound.0 = rate_hz;
        self.sound.1.extend(samples);
        let excess = self.sound.1.len().saturating_sub(MAX_SOUND_SAMPLES);
        self.sound.1.drain(..excess);
    }
}

#[derive(Debug, Default)]
struct Page {
    /// True if the stage has received [`Event::Connected`].
    known: bool,
    outbox: Outbox,
    incoming: VecDeque<Result<FromPage, String>>,
    dropped: u64,
    /// Queued release of the key, or motors-off, which replaces a release.
    stop: Option<FromPage>,
    /// Control step of the newest hold message, which replaces older ones.
    hold: Option<u32>,
}

impl Page {
    fn queue(&mut self, message: Result<FromPage, String>) {
        match message {
            Ok(FromPage::Hold { seen }) => self.hold = Some(seen),
            message => {
                if self.incoming.len() >= MAX_INCOMING_MESSAGES {
                    self.incoming.pop_front();
                    self.dropped += 1;
                }
                self.incoming.push_back(message);
            }
        }
    }

    fn drop_key_messages(&mut self) {
        self.hold = None;
        self.incoming.retain(|message| !matches!(message, Ok(FromPage::Arm { .. })));
    }

    fn next(&mut self, id: PageId) -> Option<Event> {
        let dropped = std::mem::take(&mut self.dropped);
        if dropped > 0 {
            return Some(Event::Dropped(id, dropped));
        }
        let message = self.incoming.pop_front().or_else(|| self.hold.take().map(|seen| Ok(FromPage::Hold { seen })));
        message.map(|message| Event::Received(id, message))
    }
}

#[derive(Debug, Default)]
struct Pages {
    newest: PageId,
    open: BTreeMap<PageId, Page>,
    /// Disconnected pages that the stage knows.
    gone: BTreeSet<PageId>,
    /// Page of the last event; the page after it has the next turn.
    last: PageId,
}

/// Connects the pages with the stage.
#[derive(Clone, Debug, Default)]
pub struct Hub {
    pages: Arc<Mutex<Pages>>,
}

impl Hub {
    fn pages(&self) -> MutexGuard<'_, Pages> {
        self.pages.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a page; `None` if there are too many.
    pub fn add_page(&self) -> Option<PageId> {
        let mut pages = self.pages();
        if pages.open.len() >= MAX_PAGES {
            return None;
        }
        pages.newest += 1;
        let id = pages.newest;
        let mut page = Page::default();
        page.outbox.queue_document(format!(r#"{{"is":"you","you":{id}}}"#));
        pages.open.insert(id, page);
        Some(id)
    }

    /// Removes a page.
    pub fn remove_page(&self, id: PageId) {
        let mut pages = self.pages();
        if pages.open.remove(&id).is_some_and(|page| page.known) {
            pages.gone.insert(id);
        }
    }

    /// Queues a page's message. A message that turns motors off drops the queued messages that would turn them on: of
    /// this page for a release, of all pages for a disarm.
    pub fn queue_incoming(&self, id: PageId, message: Result<FromPage, String>) {
        let mut pages = self.pages();
        let Some(page) = pages.open.get_mut(&id) else { return };
        match message {
            Ok(FromPage::Release {}) => {
                page.drop_key_messages();
                page.stop.get_or_insert(FromPage::Release {});
            }
            Ok(FromPage::Disarm {}) => {
                page.stop = Some(FromPage::Disarm {});
                pages.open.values_mut().for_each(Page::drop_key_messages);
            }
            message => page.queue(message),
        }
    }

    /// Returns the next event for the stage: first disconnected pages and messages that turn motors off, then connected
    /// pages, then one message of each page in turn.
    pub fn next(&self) -> Option<Event> {
        let mut pages = self.pages();
        if let Some(gone) = pages.gone.pop_first() {
            return Some(Event::Disconnected(gone));
        }
        // Reports a page to the stage before its messages, except for messages that turn motors off.
        let stop = pages.open.iter_mut().find_map(|(id, page)| Some((*id, page.stop.take()?)));
        if let Some((id, stop)) = stop {
            return Some(Event::Received(id, Ok(stop)));
        }
        if let Some((id, page)) = pages.open.iter_mut().find(|(_, page)| !page.known) {
            page.known = true;
            return Some(Event::Connected(*id));
        }
        let after = pages.last + 1;
        let order: Vec<PageId> =
            pages.open.range(after..).chain(pages.open.range(..after)).map(|(id, _)| *id).collect();
        for id in order {
            if let Some(event) = pages.open.get_mut(&id).and_then(|page| page.next(id)) {
                pages.last = id;
                return Some(event);
            }
        }
        None
    }

    /// Drops the queued incoming messages of all pages. The stage still knows the pages.
    pub fn drop_incoming(&self) {
        let mut pages = self.pages();
        pages.gone.clear();
        for page in pages.open.values_mut() {
            let outbox = std::mem::take(&mut page.outbox);
            *page = Page { known: true, outbox, ..Page::default() };
        }
    }

    /// Takes the outgoing queue of a page.
    pub fn take_outbox(&self, id: PageId) -> Outbox {
        self.pages().open.get_mut(&id).map(|page| std::mem::take(&mut page.outbox)).unwrap_or_default()
    }

    /// Applies `put` to the outgoing queue of one page.
    pub fn with_outbox(&self, id: PageId, put: impl FnOnce(&mut Outbox)) {
        if let Some(page) = self.pages().open.get_mut(&id) {
            put(&mut page.outbox);
        }
    }

    /// Applies `put` to the outgoing queue of every page.
    pub fn with_every_outbox(&self, mut put: impl FnMut(&mut Outbox)) {
        self.pages().open.values_mut().for_each(|page| put(&mut page.outbox));
    }

    /// Returns the number of open pages.
    pub fn count(&self) -> usize {
        self.pages().open.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn late_pages_get_the_newest_picture_and_every_message() {
        let hub = Hub::default();
        let page = hub.add_page().unwrap();
        assert_eq!(hub.next(), Some(Event::Connected(page)));
        for number in 0..3 {
            hub.with_every_outbox(|outbox| {
                outbox.picture = Some(number.to_string());
                outbox.queue_document(number.to_string());
            });
        }
        let waiting = hub.take_outbox(page);
        assert_eq!((waiting.picture.as_deref(), waiting.messages.len()), (Some("2"), 4));
        assert!(hub.take_outbox(page).picture.is_none());
        hub.remove_page(page);
        assert_eq!((hub.next(), hub.next()), (Some(Event::Disconnected(page)), None));
    }

    #[test]
    fn pages_connect_up_to_the_maximum() {
        let hub = Hub::default();
        let pages: Vec<_> = (0..=MAX_PAGES).map(|_| hub.add_page()).collect();
        assert!(pages[..MAX_PAGES].iter().all(Option::is_some) && pages[MAX_PAGES].is_none());
    }

    #[test]
    fn excess_sound_is_dropped_from_its_beginning() {
        let mut outbox = Outbox::default();
        outbox.queue_sound(1000.0, &vec![0.0; MAX_SOUND_SAMPLES]);
        outbox.queue_sound(1000.0, &[7.0]);
        assert_eq!((outbox.sound.1.len(), outbox.sound.1.back()), (MAX_SOUND_SAMPLES, Some(&7.0)));
    }

    /// Returns a hub with pages that the stage knows.
    fn hub_with_pages(pages: u64) -> Hub {
        let hub = Hub::default();
        (0..pages).for_each(|_| assert!(hub.add_page().is_some()));
        (1..=pages).for_each(|id| assert_eq!(hub.next(), Some(Event::Connected(id))));
        hub
    }

    fn received(id: PageId, message: FromPage) -> Option<Event> {
        Some(Event::Received(id, Ok(message)))
    }

    #[test]
    fn motors_off_comes_first_and_drops_earlier_key_presses() {
        for (page, stop) in [(1, FromPage::Release {}), (1, FromPage::Disarm {}), (2, FromPage::Disarm {})] {
            let hub = hub_with_pages(3);
            for message in [FromPage::Take {}, FromPage::Arm { seen: 1 }, FromPage::Hold { seen: 2 }] {
                hub.queue_incoming(1, Ok(message));
            }
            (0..10_000).for_each(|_| hub.queue_incoming(3, Err("noise".into())));
            hub.queue_incoming(page, Ok(stop.clone()));
            assert_eq!(hub.next(), received(page, stop));
            let rest: Vec<Event> = std::iter::from_fn(|| hub.next()).collect();
            let key = |message: &FromPage| matches!(message, FromPage::Arm { .. } | FromPage::Hold { .. });
            assert!(!rest.iter().any(|event| matches!(event, Event::Received(_, Ok(message)) if key(message))));
            assert!(rest.contains(&Event::Received(1, Ok(FromPage::Take {}))));
        }
    }

    #[test]
    fn a_disconnect_comes_before_the_messages_of_other_pages() {
        let hub = hub_with_pages(2);
        (0..10_000).for_each(|_| hub.queue_incoming(2, Ok(FromPage::Here {})));
        hub.remove_page(1);
        assert_eq!(hub.next(), Some(Event::Disconnected(1)));
        // A page that disconnects at once is never reported to the stage.
        let third = hub.add_page().unwrap();
        hub.remove_page(third);
        let reported = |event: Event| matches!(event, Event::Connected(_) | Event::Disconnected(_));
        assert!(!std::iter::from_fn(|| hub.next()).any(reported));
    }

    #[test]
    fn a_flooding_page_takes_turns_and_loses_its_oldest_messages() {
        let hub = hub_with_pages(2);
        (0..100_000).for_each(|number| hub.queue_incoming(1, Err(number.to_string())));
        hub.queue_incoming(2, Ok(FromPage::Take {}));
        let events: Vec<Event> = std::iter::from_fn(|| hub.next()).collect();
        let second = events.iter().position(|event| *event == Event::Received(2, Ok(FromPage::Take {})));
        assert!(second.is_some_and(|at| at < 2), "{second:?}");
        assert_eq!(events.len(), MAX_INCOMING_MESSAGES + 2);
        assert!(events.contains(&Event::Dropped(1, 100_000 - MAX_INCOMING_MESSAGES as u64)));
        assert_eq!(events.last(), Some(&Event::Received(1, Err("99999".into()))));
    }

    #[test]
    fn only_the_newest_hold_message_waits() {
        let hub = hub_with_pages(1);
        (0..1_000).for_each(|seen| hub.queue_incoming(1, Ok(FromPage::Hold { seen })));
        assert_eq!((hub.next(), hub.next()), (received(1, FromPage::Hold { seen: 999 }), None));
    }

    #[test]
    fn unread_documents_are_dropped_from_the_oldest() {
        let mut outbox = Outbox::default();
        (0..1_000).for_each(|number| outbox.queue_document(number.to_string()));
        assert_eq!(
            (outbox.messages.len(), outbox.messages.back().map(String::as_str)),
            (MAX_OUTGOING_DOCUMENTS, Some("999"))
        );
    }
}
