//! The pages that are open: what waits for each of them, and what they say.
//!
//! Whatever a page does costs a bounded memory and delays no other: of what it says and of what waits for it the oldest is
//! left out. What turns motors off has a way of its own: [`Hub::next`] gives it before everything else.

use super::message::FromPage;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Most pages at once.
pub const MOST_PAGES: usize = 16;
/// Most messages of a page that wait for the stage.
const SAID: usize = 64;
/// Most documents that wait for a page; its pictures are not among them.
const TOLD: usize = 256;
/// Most samples of sound that wait for a page; older ones are dropped.
const SOUND: usize = 16_384;

/// A page, by the number that it got when it came.
pub type PageId = u64;

/// An event of a page, for the stage.
#[derive(Debug, PartialEq)]
pub enum Event {
    /// It connected.
    Came(PageId),
    /// It sent a message, or something that is not one: then the reason.
    Said(PageId, Result<FromPage, String>),
    /// So many of its messages were left out, because more came than the stage could hear.
    LeftOut(PageId, u64),
    /// It disconnected, for whatever reason.
    Gone(PageId),
}

/// A message to a page.
#[derive(Clone, Debug, PartialEq)]
pub enum Message {
    /// A JSON document.
    Text(String),
    /// Numbers, each four bytes: what they are, then a sweep ([`super::scope::Scope::bytes`]) or rate and sound.
    Bytes(Vec<u8>),
}

/// Everything that waits for a page. Messages keep their order, and the oldest are dropped if the page reads too
/// slowly; of pictures and scopes the newest counts.
#[derive(Debug, Default)]
pub struct Outbox {
    /// JSON documents, see [`Outbox::tell`].
    pub messages: VecDeque<String>,
    /// The newest picture, a JSON document.
    pub picture: Option<String>,
    /// The newest scope, as [`super::scope::Scope::bytes`] packs it.
    pub scope: Option<Vec<u8>>,
    /// Motor torque to listen to, N m, and its rate in Hz.
    pub sound: (f32, VecDeque<f32>),
}

impl Outbox {
    /// The messages to send, in this order: JSON as text, numbers as bytes.
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
    pub fn tell(&mut self, document: String) {
        if self.messages.len() >= TOLD {
            self.messages.pop_front();
        }
        self.messages.push_back(document);
    }

    /// Adds samples to listen to.
    pub fn hear(&mut self, rate_hz: f32, samples: &[f32]) {
        self.sound.0 = rate_hz;
        self.sound.1.extend(samples);
        let late = self.sound.1.len().saturating_sub(SOUND);
        self.sound.1.drain(..late);
    }
}

/// A page as the hub knows it.
#[derive(Debug, Default)]
struct Page {
    /// True if the stage knows of it.
    known: bool,
    outbox: Outbox,
    said: VecDeque<Result<FromPage, String>>,
    left_out: u64,
    /// It lets the key go, or turns the motors off; of both the second.
    stops: Option<FromPage>,
    /// Its last message about its key: an older one says less.
    holds: Option<u32>,
}

impl Page {
    fn hears(&mut self, message: Result<FromPage, String>) {
        match message {
            Ok(FromPage::Hold { seen }) => self.holds = Some(seen),
            message => {
                if self.said.len() >= SAID {
                    self.said.pop_front();
                    self.left_out += 1;
                }
                self.said.push_back(message);
            }
        }
    }

    /// Forgets what it has said of its key so far.
    fn lets_go(&mut self) {
        self.holds = None;
        self.said.retain(|said| !matches!(said, Ok(FromPage::Arm { .. })));
    }

    fn next(&mut self, id: PageId) -> Option<Event> {
        let left_out = std::mem::take(&mut self.left_out);
        if left_out > 0 {
            return Some(Event::LeftOut(id, left_out));
        }
        let said = self.said.pop_front().or_else(|| self.holds.take().map(|seen| Ok(FromPage::Hold { seen })));
        said.map(|said| Event::Said(id, said))
    }
}

#[derive(Debug, Default)]
struct Pages {
    /// The number of the newest.
    newest: PageId,
    open: BTreeMap<PageId, Page>,
    /// Those that the stage knows of and that have gone.
    gone: BTreeSet<PageId>,
    /// The page that was heard last: the next one has its turn.
    heard: PageId,
}

/// The meeting place of pages and stage.
#[derive(Clone, Debug, Default)]
pub struct Hub {
    pages: Arc<Mutex<Pages>>,
}

impl Hub {
    fn pages(&self) -> MutexGuard<'_, Pages> {
        self.pages.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Lets a page in; `None` where there are too many.
    pub fn come(&self) -> Option<PageId> {
        let mut pages = self.pages();
        if pages.open.len() >= MOST_PAGES {
            return None;
        }
        pages.newest += 1;
        let id = pages.newest;
        let mut page = Page::default();
        page.outbox.tell(format!(r#"{{"is":"you","you":{id}}}"#));
        pages.open.insert(id, page);
        Some(id)
    }

    /// Forgets a page.
    pub fn go(&self, id: PageId) {
        let mut pages = self.pages();
        if pages.open.remove(&id).is_some_and(|page| page.known) {
            pages.gone.insert(id);
        }
    }

    /// Takes in what a page said. What turns motors off takes back whatever was said to turn them on and not yet heard:
    /// by this page where it lets go, by any where it turns them off.
    pub fn said(&self, id: PageId, message: Result<FromPage, String>) {
        let mut pages = self.pages();
        let Some(page) = pages.open.get_mut(&id) else { return };
        match message {
            Ok(FromPage::Release {}) => {
                page.lets_go();
                page.stops.get_or_insert(FromPage::Release {});
            }
            Ok(FromPage::Disarm {}) => {
                page.stops = Some(FromPage::Disarm {});
                pages.open.values_mut().for_each(Page::lets_go);
            }
            message => page.hears(message),
        }
    }

    /// The next event for the stage: pages that have gone and messages that turn motors off, then pages that have come,
    /// then one message of each page in turn.
    pub fn next(&self) -> Option<Event> {
        let mut pages = self.pages();
        if let Some(gone) = pages.gone.pop_first() {
            return Some(Event::Gone(gone));
        }
        // A page is known before it is heard, but for what turns motors off.
        let stops = pages.open.iter_mut().find_map(|(id, page)| Some((*id, page.stops.take()?)));
        if let Some((id, stop)) = stops {
            return Some(Event::Said(id, Ok(stop)));
        }
        if let Some((id, page)) = pages.open.iter_mut().find(|(_, page)| !page.known) {
            page.known = true;
            return Some(Event::Came(*id));
        }
        let after = pages.heard + 1;
        let order: Vec<PageId> =
            pages.open.range(after..).chain(pages.open.range(..after)).map(|(id, _)| *id).collect();
        for id in order {
            if let Some(event) = pages.open.get_mut(&id).and_then(|page| page.next(id)) {
                pages.heard = id;
                return Some(event);
            }
        }
        None
    }

    /// Forgets what pages have said so far; they count as known.
    pub fn forget(&self) {
        let mut pages = self.pages();
        pages.gone.clear();
        for page in pages.open.values_mut() {
            let outbox = std::mem::take(&mut page.outbox);
            *page = Page { known: true, outbox, ..Page::default() };
        }
    }

    /// Takes what waits for a page.
    pub fn take(&self, id: PageId) -> Outbox {
        self.pages().open.get_mut(&id).map(|page| std::mem::take(&mut page.outbox)).unwrap_or_default()
    }

    /// Does something to what waits for one page.
    pub fn to(&self, id: PageId, put: impl FnOnce(&mut Outbox)) {
        if let Some(page) = self.pages().open.get_mut(&id) {
            put(&mut page.outbox);
        }
    }

    /// Does something to what waits for every page.
    pub fn to_all(&self, mut put: impl FnMut(&mut Outbox)) {
        self.pages().open.values_mut().for_each(|page| put(&mut page.outbox));
    }

    /// Number of pages that are open.
    pub fn count(&self) -> usize {
        self.pages().open.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_that_is_late_sees_the_newest_picture_and_every_message() {
        let hub = Hub::default();
        let page = hub.come().unwrap();
        assert_eq!(hub.next(), Some(Event::Came(page)));
        for number in 0..3 {
            hub.to_all(|outbox| {
                outbox.picture = Some(number.to_string());
                outbox.tell(number.to_string());
            });
        }
        let waiting = hub.take(page);
        assert_eq!((waiting.picture.as_deref(), waiting.messages.len()), (Some("2"), 4));
        assert!(hub.take(page).picture.is_none());
        hub.go(page);
        assert_eq!((hub.next(), hub.next()), (Some(Event::Gone(page)), None));
    }

    #[test]
    fn pages_are_let_in_until_there_are_too_many() {
        let hub = Hub::default();
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

    /// A hub with so many pages that the stage knows of.
    fn known(pages: u64) -> Hub {
        let hub = Hub::default();
        (0..pages).for_each(|_| assert!(hub.come().is_some()));
        (1..=pages).for_each(|id| assert_eq!(hub.next(), Some(Event::Came(id))));
        hub
    }

    fn said(id: PageId, message: FromPage) -> Option<Event> {
        Some(Event::Said(id, Ok(message)))
    }

    #[test]
    fn what_turns_motors_off_is_heard_first_and_no_key_that_was_pressed_before_it_is() {
        for (page, stop) in [(1, FromPage::Release {}), (1, FromPage::Disarm {}), (2, FromPage::Disarm {})] {
            let hub = known(3);
            for message in [FromPage::Take {}, FromPage::Arm { seen: 1 }, FromPage::Hold { seen: 2 }] {
                hub.said(1, Ok(message));
            }
            (0..10_000).for_each(|_| hub.said(3, Err("noise".into())));
            hub.said(page, Ok(stop.clone()));
            assert_eq!(hub.next(), said(page, stop));
            let rest: Vec<Event> = std::iter::from_fn(|| hub.next()).collect();
            assert!(
                !rest
                    .iter()
                    .any(|event| matches!(event, Event::Said(_, Ok(FromPage::Arm { .. } | FromPage::Hold { .. }))))
            );
            assert!(rest.contains(&Event::Said(1, Ok(FromPage::Take {}))));
        }
    }

    #[test]
    fn a_page_that_has_gone_is_heard_of_before_all_that_the_others_say() {
        let hub = known(2);
        (0..10_000).for_each(|_| hub.said(2, Ok(FromPage::Here {})));
        hub.go(1);
        assert_eq!(hub.next(), Some(Event::Gone(1)));
        // One that went before the stage knew of it is nothing to it.
        let third = hub.come().unwrap();
        hub.go(third);
        assert!(std::iter::from_fn(|| hub.next()).all(|event| !matches!(event, Event::Came(_) | Event::Gone(_))));
    }

    #[test]
    fn a_page_that_floods_is_heard_in_turn_with_the_others_and_its_oldest_messages_are_left_out() {
        let hub = known(2);
        (0..100_000).for_each(|number| hub.said(1, Err(number.to_string())));
        hub.said(2, Ok(FromPage::Take {}));
        let heard: Vec<Event> = std::iter::from_fn(|| hub.next()).collect();
        let second = heard.iter().position(|event| *event == Event::Said(2, Ok(FromPage::Take {})));
        assert!(second.is_some_and(|at| at < 2), "{second:?}");
        assert_eq!(heard.len(), SAID + 2);
        assert!(heard.contains(&Event::LeftOut(1, 100_000 - SAID as u64)));
        assert_eq!(heard.last(), Some(&Event::Said(1, Err("99999".into()))));
    }

    #[test]
    fn of_a_key_that_is_held_only_the_newest_message_waits() {
        let hub = known(1);
        (0..1_000).for_each(|seen| hub.said(1, Ok(FromPage::Hold { seen })));
        assert_eq!((hub.next(), hub.next()), (said(1, FromPage::Hold { seen: 999 }), None));
    }

    #[test]
    fn what_a_page_does_not_read_is_left_out_from_its_beginning() {
        let mut outbox = Outbox::default();
        (0..1_000).for_each(|number| outbox.tell(number.to_string()));
        assert_eq!((outbox.messages.len(), outbox.messages.back().map(String::as_str)), (TOLD, Some("999")));
    }
}
