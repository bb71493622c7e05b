//! Prints the texts of pictures, one per line: file, text, confidence, x and y of the middle, angle in
//! degrees, height in pixels, seconds for the picture; tabs between them.
//!
//! `cargo run --release -p planish-exchange --example read_words -- PICTURE...`

#![allow(clippy::print_stdout, reason = "a program whose output is a table")]

use planish_exchange::glyphs::read_words;
use planish_exchange::picture::read_brightness;
use std::path::Path;
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    for file in std::env::args().skip(1) {
        let image = read_brightness(Path::new(&file))?;
        let begun = Instant::now();
        let found = read_words(&image);
        let seconds = begun.elapsed().as_secs_f64();
        for word in found.words {
            let [x, y] = word.middle();
            let (text, sure, degrees) = (&word.text, word.confidence, word.angle_rad.to_degrees());
            println!(
                "{file}\t{text}\t{sure:.5}\t{x:.1}\t{y:.1}\t{degrees:.1}\t{:.1}\t{seconds:.3}",
                word.height
            );
        }
    }
    Ok(())
}
