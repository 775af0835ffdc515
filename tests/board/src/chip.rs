//! The microcontroller.

pub use rigless::soc::stm32f427::Stm32f427 as Chip;
