//! The content security policy of pages: which scripts and styles a browser may use.
//!
//! In: the text of the style and scripts that belong to every page. Out: a policy that permits exactly these,
//! by their SHA-256 (W3C Content Security Policy Level 3, section 2.3.1). A script or style that gets into a
//! page by a name in a file is not run, even if it was not escaped.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use sha2::{Digest, Sha256};
use std::sync::LazyLock;

/// Style and scripts of all pages.
pub(crate) struct Assets {
    /// The style sheet.
    pub style: String,
    /// The scripts of the 3D view, in the order in which they run.
    pub scripts: [String; 2],
    policy: String,
}

/// Everything is in the file: a report is mailed, archived and opened without a network.
pub(crate) static ASSETS: LazyLock<Assets> = LazyLock::new(|| {
    // Browsers replace CR LF, which a checkout on Windows can contain, by LF before they compute the hash.
    let text = |source: &str| source.replace("\r\n", "\n");
    let style = text(include_str!("../assets/page.css"));
    // three.js is minified and part of the sources, so that a build needs no Node (decision 0080).
    let scripts = [include_str!("../assets/three.min.js"), include_str!("../assets/viewer.js")].map(text);
    let policy = format!(
        "default-src 'none'; style-src {}; script-src {} {}; img-src data:; base-uri 'none'; \
         form-action 'none'",
        hash_source(&style),
        hash_source(&scripts[0]),
        hash_source(&scripts[1])
    );
    Assets { style, scripts, policy }
});

/// The content security policy of every page, for a `meta` element or a header field.
///
/// A server should add `frame-ancestors 'none'`, which browsers accept in the header field only.
///
/// # Examples
/// ```
/// let policy = planish_report::content_policy();
/// assert!(policy.starts_with("default-src 'none'; style-src 'sha256-"));
/// assert!(!policy.contains("unsafe-inline"));
/// ```
#[must_use]
pub fn content_policy() -> &'static str {
    &ASSETS.policy
}

/// The source expression that permits an inline script or style with this text.
pub(crate) fn hash_source(text: &str) -> String {
    format!("'sha256-{}'", STANDARD.encode(Sha256::digest(text.as_bytes())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hashes_are_those_of_the_standard() {
        // The example of Content Security Policy Level 3, section 2.3.1.
        assert_eq!(
            hash_source("alert('Hello, world.');"),
            "'sha256-qznLcsROx4GACP2dm0UCKCzCG+HiZ1guq6ZZDob/Tng='"
        );
    }

    #[test]
    fn assets_keep_their_elements_closed() {
        // An end tag in the text would end the element early, so that the rest would be shown and the hash
        // wrong.
        let scripts = ASSETS.scripts.iter().map(|script| (script, "</script"));
        for (text, end) in scripts.chain([(&ASSETS.style, "</style")]) {
            let text = text.to_ascii_lowercase();
            assert!(!text.contains(end) && !text.contains("<!--") && !text.contains(['\r', '\0']), "{end}");
        }
    }
}
