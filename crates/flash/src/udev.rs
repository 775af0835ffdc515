//! The udev rule with which Linux lets the local user open boards and boot loaders.

/// USB vendor and product id of the boot loader in ST's chips (AN2606).
pub const BOOT_LOADER: (u16, u16) = (0x0483, 0xDF11);
/// USB vendor and product id of the boards, and the product name that distinguishes the boards from other devices with
/// this test id.
pub const BOARD: (u16, u16, &str) = (0x1209, 0x0001, "haptic-bridge");
/// Path of the rule file. The number in its name must be lower than 73, the number of the system's rules that read the
/// tag `uaccess`.
pub const RULE_PATH: &str = "/etc/udev/rules.d/70-haptic-bridge.rules";

/// Returns the contents of the rule file.
pub fn rule() -> String {
    let (vendor, product) = BOOT_LOADER;
    let (board_vendor, board_product, name) = BOARD;
    format!(
        "# haptic-bridge boards, for the local user of this computer; ModemManager ignores them. {RULE_PATH}\n\
         # The boot loader in the chip:\n\
         SUBSYSTEM==\"usb\", ATTR{{idVendor}}==\"{vendor:04x}\", ATTR{{idProduct}}==\"{product:04x}\", \
         TAG+=\"uaccess\"\n\
         # The board that runs, and its serial port:\n\
         SUBSYSTEM==\"usb\", ATTR{{idVendor}}==\"{board_vendor:04x}\", ATTR{{idProduct}}==\"{board_product:04x}\", \
         ATTR{{product}}==\"{name}\", ENV{{ID_MM_DEVICE_IGNORE}}=\"1\"\n\
         SUBSYSTEM==\"tty\", ATTRS{{idVendor}}==\"{board_vendor:04x}\", ATTRS{{idProduct}}==\"{board_product:04x}\", \
         ATTRS{{product}}==\"{name}\", TAG+=\"uaccess\", ENV{{ID_MM_DEVICE_IGNORE}}=\"1\"\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_line_is_a_comment_or_key_value_pairs() {
        let rule = rule();
        assert!(rule.contains("ATTR{idVendor}==\"0483\", ATTR{idProduct}==\"df11\", TAG+=\"uaccess\""), "{rule}");
        for line in rule.lines() {
            let parts: Vec<&str> = line.split(", ").collect();
            assert!(
                line.starts_with('#') || parts.iter().all(|part| part.contains('=') && part.ends_with('"')),
                "{line}"
            );
        }
    }

    #[cfg(feature = "usb")]
    #[test]
    fn the_ids_are_those_of_the_host_crate() {
        use haptic_host::link::{USB_PRODUCT, USB_PRODUCT_NAME, USB_VENDOR};
        assert_eq!(BOARD, (USB_VENDOR, USB_PRODUCT, USB_PRODUCT_NAME));
    }
}
