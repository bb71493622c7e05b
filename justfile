# Short names for what is typed often. `just check` is what lands a change.

check:
    .ci/run

# The heavy statistics: two hundred seeded draws of each kind.
nightly:
    cargo test --release --workspace -- --ignored --nocapture

docs:
    cargo doc --workspace --no-deps

# Damaged files for every reader; the checks run two thousand of each.
fuzz:
    cargo run --release -p planish-fuzz -- --cases 1000000

bench:
    cargo bench -p planish-estimate
