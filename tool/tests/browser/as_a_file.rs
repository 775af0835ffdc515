//! The page as a file, without tool and server; `cargo xtask test --deep browser` makes the file first.

use super::common::root;
use super::devtools::{Browser, Tab};
use super::{LAPTOP, as_an_expert, drag_the_wall, place_before_wall, plane_place};

pub fn path() -> String {
    std::env::var("HAPTIC_PLAYGROUND")
        .unwrap_or_else(|_| root().join("target/playground/haptic-page.html").display().to_string())
}

fn open_page() -> (Browser, Tab) {
    let mut browser = Browser::start();
    let tab = browser.open(&format!("file://{}", path()), LAPTOP, 1.0);
    browser.wait_until(
        &tab,
        "window.view && view.pictures > 3 && view.plane !== null && document.body.dataset.role === 'command'",
    );
    browser.bring_to_front(&tab);
    as_an_expert(&mut browser, &tab);
    (browser, tab)
}

#[test]
fn the_page_as_a_file_is_alive_and_requests_nothing() {
    let (mut browser, tab) = open_page();
    let count = |browser: &mut Browser, what: &str| browser.evaluate(&tab, what).as_u64().unwrap();
    let (pictures, sweeps) = (count(&mut browser, "view.pictures"), count(&mut browser, "view.sweeps"));
    browser.wait_until(&tab, &format!("view.pictures > {} && view.sweeps > {}", pictures + 20, sweeps + 10));
    browser.evaluate(&tab, "$('sound').click()");
    browser.wait_until(&tab, "view.sounds > 5");
    assert_eq!(
        browser.evaluate(&tab, "view.hello.rows_hz === view.hello.rate_hz"),
        true,
        "every control step is sent as a row"
    );
    // Controls that need the tool are hidden.
    assert_eq!(browser.evaluate(&tab, "$('record').offsetParent"), serde_json::Value::Null);
    let own = format!("file://{}", path());
    let asked: Vec<String> =
        browser.requested_urls().into_iter().filter(|url| *url != own && url != "about:blank").collect();
    assert!(asked.iter().all(|url| url.starts_with("data:") || url.starts_with("blob:null/")), "{asked:?}");
    assert_eq!(browser.console_errors(), [""; 0]);
    // The page's content security policy blocks requests.
    browser.evaluate(
        &tab,
        "view.forbidden = []; addEventListener('securitypolicyviolation', e => view.forbidden.push(e.effectiveDirective)); \
         fetch('http://127.0.0.1:9/').catch(() => 0); new Image().src = 'http://127.0.0.1:9/';",
    );
    browser.wait_until(&tab, "view.forbidden.includes('connect-src') && view.forbidden.includes('img-src')");
}

#[test]
fn the_page_as_a_file_changes_gains_walls_and_devices() {
    let (mut browser, tab) = open_page();
    let (from, to) = (plane_place(&mut browser, &tab, 80.0, 8700.0), plane_place(&mut browser, &tab, 40.0, 10e3));
    browser.drag(&tab, from, to);
    browser
        .wait_until(&tab, "Math.abs(view.walls[0].damping - 40) < 1 && Math.abs(view.walls[0].stiffness - 10e3) < 200");
    drag_the_wall(&mut browser, &tab);
    let count = browser.evaluate(&tab, "$('choice').length").as_u64().unwrap();
    assert!(count >= 5, "{count} devices");
    for choice in (0..count).rev() {
        let pictures = browser.evaluate(&tab, "view.pictures").as_u64().unwrap();
        browser.evaluate(
            &tab,
            &format!("$('choice').selectedIndex = {choice}; $('choice').dispatchEvent(new Event('change'))"),
        );
        browser.wait_until(
            &tab,
            &format!(
                "view.hello && $('choice').selectedOptions[0].text.startsWith(shown() + ':') && view.pictures > {} && \
                 document.body.dataset.role === 'command'",
                pictures + 10
            ),
        );
        assert_eq!(browser.evaluate(&tab, "$('notice').classList.contains('shown')"), false, "choice {choice}");
    }
    // One link sets up a lesson, the other one another device.
    let links = [("lesson=1", "hapkit-paddle"), ("device=haply-2diy/groove&pose=1.9,1.1", "haply-2diy")];
    for (link, device) in links {
        browser.evaluate(&tab, &format!("location.hash = '{link}'"));
        browser.wait_until(
            &tab,
            &format!("view.hello?.device === '{device}' && view.last && view.wanted === null && view.pictures > 10"),
        );
    }
    browser.wait_until(
        &tab,
        "$('choice').selectedOptions[0].text.includes('groove') && Math.abs(view.last.q[0] - 1.9) < 1e-2",
    );
    browser.evaluate(&tab, "location.hash = 'device=nothing'");
    browser.wait_until(&tab, "$('why').textContent.includes('s device nothing')");
    browser.evaluate(&tab, "notice(''); $('choice').selectedIndex = 0; $('choice').onchange()");
    browser
        .wait_until(&tab, "view.hello?.smooth && view.last && view.frame && document.body.dataset.role === 'command'");
    // Choosing the demo again resets it, and its hand follows the mouse.
    assert_eq!(browser.evaluate(&tab, "view.walls[0].feed_forward"), "washout");
    let place = place_before_wall(&mut browser, &tab, 0.03);
    browser.send_mouse(&tab, "mousePressed", place);
    browser.send_mouse(&tab, "mouseReleased", place);
    browser.wait_until(&tab, "view.last.hand !== null");
    assert_eq!(browser.console_errors(), [""; 0]);
}
