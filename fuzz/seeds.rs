//! Writes the fuzzers' first corpus: one small recording and message a form.
//! `cargo run --manifest-path fuzz/Cargo.toml --bin seeds`, in the project's folder.

use std::fs;
use std::io::Cursor;
use tirante::analysis::signal::record::{Timestamp, Unit};
use tirante::recording::write::{ChannelSpec, Compression, Encoding, Layout, Precision, RecordingWriter, WriterOptions, message};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let start = Timestamp::from_nanos(1_700_000_000_000_000_000);
    for target in ["recording", "message", "stamps", "protocol", "import"] {
        fs::create_dir_all(format!("fuzz/corpus/{target}"))?;
    }
    for encoding in [Encoding::Json, Encoding::Protobuf, Encoding::Ros2] {
        for (layout, form) in [(Layout::Sample, "sample"), (Layout::Batch(10), "batch")] {
            for compression in [Compression::Zstd, Compression::Lz4, Compression::None] {
                for chunk_bytes in [None, Some(500)] {
                    let options = WriterOptions { compression, chunk_bytes, ..Default::default() };
                    let mut writer = RecordingWriter::new(Cursor::new(Vec::new()), options)?;
                    let spec = ChannelSpec { topic: "/laser".into(), encoding, layout, precision: Precision::Double, unit: Unit::Millimetre };
                    let id = writer.add_channel(spec)?;
                    let samples: Vec<f64> = (0..30).map(|i| (f64::from(i) * 0.7).sin()).collect();
                    writer.write_samples(id, start, 200.0, &samples)?;
                    let bytes = writer.finish()?.into_inner();
                    let chunked = chunk_bytes.is_some();
                    fs::write(format!("fuzz/corpus/recording/{encoding:?}-{form}-{compression:?}-{chunked}"), bytes)?;
                }
            }
            let schema = message::schema(encoding, layout, Precision::Double);
            let (kind, path) = match (encoding, layout) {
                (Encoding::Json, Layout::Sample) => (0u8, "value"),
                (Encoding::Json, Layout::Batch(_)) => (1, "values"),
                (Encoding::Protobuf, Layout::Batch(_)) => (2, "values"),
                (Encoding::Protobuf, Layout::Sample) => (3, "value"),
                (Encoding::Ros2, Layout::Batch(_)) => (4, "values[1]"),
                (Encoding::Ros2, Layout::Sample) => (5, "data"),
            };
            for time in 0..4 {
                let mut seed = vec![kind + 6 * time];
                seed.extend(path.bytes());
                seed.push(0xfe);
                seed.extend(&schema.data);
                seed.push(0xfe);
                match layout {
                    Layout::Sample => message::encode_sample(&mut seed, encoding, Precision::Double, 1.5),
                    Layout::Batch(_) => message::encode_batch(&mut seed, encoding, Precision::Double, (start, 200.0, Unit::Millimetre), &[1.0, -2.5e-3]),
                }
                fs::write(format!("fuzz/corpus/message/{encoding:?}-{form}-{time}"), seed)?;
            }
        }
    }
    let lines = b"{\"topic\":\"/laser\",\"time\":5,\"value\":1e-5}\n{\"topic\":\"/none\",\"value\":1}\n{\"end\":true}\n";
    let hello = b"{\"hello\":{\"sender\":\"north\"}}\n";
    let mcap = fs::read("fuzz/corpus/recording/Json-sample-Zstd-true")?;
    let twice = [&mcap[..], &mcap[..]].concat();
    for (name, stream) in [("lines", lines.to_vec()), ("named", [&hello[..], lines].concat()), ("mcap", [&hello[..], &mcap].concat()), ("twice", twice)] {
        fs::write(format!("fuzz/corpus/protocol/{name}"), [&[50u8][..], &stream].concat())?;
    }
    for kind in 0..3u8 {
        let steps: Vec<u8> = (0..600u32).map(|i| (i * i % 251) as u8 % 100).collect();
        fs::write(format!("fuzz/corpus/stamps/{kind}"), [vec![kind], steps].concat())?;
    }
    for file in fs::read_dir("tests/fixtures/import")? {
        let file = file?;
        // Their maker and its answers are no measurements.
        if file.path().extension().is_some_and(|kind| kind == "py" || kind == "json") {
            continue;
        }
        // Rate and full scale said, format found from the content.
        let seed = [&[24u8][..], &fs::read(file.path())?].concat();
        fs::write(format!("fuzz/corpus/import/{}", file.file_name().to_string_lossy()), seed)?;
    }
    Ok(())
}
