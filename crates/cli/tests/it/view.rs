//! `planish view`: images and pages of files.

use crate::support::{command, names, pebble, planish};
use serde_json::Value;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Stdio};

#[test]
fn image_is_written_and_described() {
    let folder = tempfile::tempdir().expect("a folder");
    let result = planish(
        folder.path(),
        &["view", &pebble("truth.ply"), "-o", "a.png", "--camera=-30,20", "--size", "200x150", "--json"],
    )
    .ok()
    .json();
    assert_eq!(result["color"], "plain");
    assert_eq!(result["size"], serde_json::json!([200, 150]));
    assert!(result["covered"].as_f64().is_some_and(|covered| (0.2..0.8).contains(&covered)));
    assert_eq!(names(folder.path()), ["a.png"]);
    let bytes = std::fs::read(folder.path().join("a.png")).expect("a picture");
    assert!(bytes.starts_with(b"\x89PNG"));
    // The same command gives the same bytes with another number of threads.
    planish(
        folder.path(),
        &[
            "view",
            &pebble("truth.ply"),
            "-o",
            "b.png",
            "--camera=-30,20",
            "--size",
            "200x150",
            "--threads",
            "3",
        ],
    )
    .ok();
    assert_eq!(std::fs::read(folder.path().join("b.png")).expect("a picture"), bytes);
}

#[test]
fn page_is_written_on_request() {
    let folder = tempfile::tempdir().expect("a folder");
    planish(folder.path(), &["view", &pebble("truth.ply"), "-o", "a.html", "--quiet"]).ok();
    let page = std::fs::read_to_string(folder.path().join("a.html")).expect("a page");
    assert!(page.contains("A mesh of 5120 triangles") && page.contains("id=\"scene\""));
}

#[test]
fn unsupported_options_and_formats_are_rejected() {
    let folder = tempfile::tempdir().expect("a folder");
    for (args, words) in [
        (&["-o", "a.jpg"][..], "expected .png (an image) or .html (a page)"),
        (&["-o", "a.png", "--color", "sigma"], "--color"),
        (&["-o", "a.png", "--camera", "0,100"], "-90 to 90"),
        (&["--color", "plain"], "--output"),
        (&["-o", "a.png", "--port", "80"], "cannot be used with"),
    ] {
        let truth = pebble("truth.ply");
        let args: Vec<&str> = ["view", &truth].into_iter().chain(args.iter().copied()).collect();
        let result = planish(folder.path(), &args);
        assert_eq!(result.code, 2, "{args:?}: {}", result.stderr);
        let is_named = result.stderr.contains(words)
            || words == "--color" && result.stderr.contains("the field sigma to colour by");
        assert!(is_named, "{args:?}: {}", result.stderr);
    }
    assert!(names(folder.path()).is_empty());
}

/// A process that is killed when the test ends.
struct Served(Child);

impl Drop for Served {
    fn drop(&mut self) {
        // The process may have ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The response of the server to a request.
fn ask(address: &str, request: &str) -> String {
    let mut stream = TcpStream::connect(address).expect("a server");
    stream.write_all(request.as_bytes()).expect("a request");
    let mut answer = String::new();
    stream.read_to_string(&mut answer).expect("an answer");
    answer
}

#[test]
fn page_is_served_locally_until_ctrl_c() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut child = command(folder.path(), &["view", &pebble("truth.ply"), "--no-open", "--json"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("planish runs");
    let stderr = child.stderr.take().expect("stderr");
    let mut served = Served(child);
    let mut line = String::new();
    BufReader::new(stderr).read_line(&mut line).expect("a line");
    let address = line.split("http://").nth(1).and_then(|rest| rest.split('/').next()).expect("an address");
    assert!(address.starts_with("127.0.0.1:"), "{line}");
    let page = ask(address, &format!("GET / HTTP/1.1\r\nHost: {address}\r\n\r\n"));
    assert!(page.starts_with("HTTP/1.1 200 OK\r\n") && page.contains("A mesh of 5120 triangles"));
    let length =
        page.split("Content-Length: ").nth(1).and_then(|rest| rest.split('\r').next()).expect("a length");
    let body = page.split_once("\r\n\r\n").expect("a body").1;
    assert_eq!(body.len().to_string(), length);
    assert!(
        ask(address, &format!("GET /other HTTP/1.1\r\nHost: {address}\r\n\r\n")).starts_with("HTTP/1.1 404")
    );
    // A web site that points its own name at this address gets no data.
    assert!(ask(address, "GET / HTTP/1.1\r\nHost: elsewhere.example\r\n\r\n").starts_with("HTTP/1.1 403"));
    #[cfg(unix)]
    {
        let stopped = std::process::Command::new("kill")
            .args(["-INT", &served.0.id().to_string()])
            .status()
            .expect("kill runs");
        assert!(stopped.success());
        let mut result = String::new();
        let mut stdout = served.0.stdout.take().expect("stdout");
        stdout.read_to_string(&mut result).expect("a summary");
        assert!(served.0.wait().expect("an end").success());
        let result: Value = serde_json::from_str(&result).expect("JSON");
        assert_eq!(result["requests"], 1);
        assert!(TcpStream::connect(address).is_err(), "the server is gone");
    }
}

#[test]
fn port_in_use_is_reported() {
    let folder = tempfile::tempdir().expect("a folder");
    let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let port = listener.local_addr().expect("a port").port().to_string();
    let result = planish(folder.path(), &["view", &pebble("truth.ply"), "--no-open", "--port", &port]);
    assert_eq!(result.code, 3, "{}", result.stderr);
    assert!(result.stderr.contains(&port) && result.stderr.contains("--port"), "{}", result.stderr);
}
