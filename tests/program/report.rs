//! `densecloud report` and `upsample --report` as a process.

use serde_json::Value;

use crate::support::{run, within};

/// A sampled knot, its dense cloud, and the page that `upsample` made of them.
fn made(path: impl Fn(&str) -> String) -> [String; 3] {
    let [sparse, dense, page] = ["sparse.ply", "dense.ply", "made.html"].map(path);
    assert!(run(&["sample", "shape:knot", &sparse, "--points", "3200"]).status.success());
    let arguments = ["upsample", &sparse, &dense, "--confidence", "--report", &page, "--quiet"];
    let done = run(&arguments);
    assert!(done.status.success(), "{done:?}");
    [sparse, dense, page]
}

/// The pictures in a page.
fn pictures(page: &str) -> Vec<(u32, u32)> {
    let encoded = page.split("src=\"data:image/png;base64,").skip(1).map(|rest| rest.split('"').next());
    encoded
        .map(|text| {
            let png = base64::Engine::decode(&base64::prelude::BASE64_STANDARD, text.expect("an end"));
            let mut reader =
                png::Decoder::new(std::io::Cursor::new(png.expect("base 64"))).read_info().expect("a PNG");
            let mut pixels = vec![0; reader.output_buffer_size().expect("a size")];
            let info = reader.next_frame(&mut pixels).expect("a picture");
            assert!(pixels.iter().any(|p| *p != pixels[0]), "nothing is drawn");
            (info.width, info.height)
        })
        .collect()
}

#[test]
fn a_report_shows_a_result_beside_its_input_and_needs_nothing_else() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    let [sparse, dense, made] = made(&path);
    let (page, numbers) = (path("page.html"), path("numbers.json"));
    for threads in ["1", "2"] {
        let mut program = crate::support::densecloud();
        let report = program.args(["report", &sparse, &dense, "-o", &page, "--json", &numbers]);
        assert!(report.env("RAYON_NUM_THREADS", threads).status().expect("the program starts").success());
        let now = std::fs::read(&page).expect("a page");
        if let Ok(before) = std::fs::read(path("before.html")) {
            assert!(before == now, "bytes depend on threads");
        }
        std::fs::write(path("before.html"), now).expect("a file");
    }
    let text = std::fs::read_to_string(&page).expect("text");
    assert_eq!(pictures(&text), [(1120, 420); 4]);
    assert!(!text.contains("http:") && !text.contains("https:") && !text.contains("<script"));
    let numbers: Value = serde_json::from_slice(&std::fs::read(&numbers).expect("numbers")).expect("JSON");
    assert_eq!(numbers["output"]["inspection"]["points"], 12_800);
    assert_eq!((&numbers["far"], &numbers["warnings"]), (&0.0.into(), &Value::Array(Vec::new())));
    for histogram in ["spacing", "displacement", "confidence"] {
        let shares = numbers[histogram]["output"].as_array().expect("shares");
        assert!((shares.iter().filter_map(Value::as_f64).sum::<f64>() - 1.0).abs() < 1e-9, "{histogram}");
    }
    let rings = numbers["density_by_distance"]["rings"].as_array().expect("rings");
    for ring in rings {
        let ratio = ring["output"].as_f64().expect("a density") / ring["input"].as_f64().expect("a density");
        assert!((3.0..5.0).contains(&ratio), "each place is four times denser: {ring}");
    }
    assert_eq!(rings.len(), 10);
    // That of the work tells how long it took, too.
    let made = std::fs::read_to_string(&made).expect("text");
    assert_eq!(pictures(&made), pictures(&text));
    assert!(made.contains("Made in ") && !text.contains("Made in "));
    let hashes = |page: &str| page.matches("SHA-256").count();
    assert_eq!((hashes(&made), hashes(&text)), (1, 2), "of files that were read");
}

#[test]
fn a_report_tells_what_is_far_and_what_is_lost() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    let grid = |n: i32, of: fn(i32, i32) -> bool, z: f64| {
        (0..n * n)
            .filter(|i| of(i % n, i / n))
            .map(|i| format!("{} {} {z}\n", i % n, i / n))
            .collect::<String>()
    };
    let whole = grid(40, |_, _| true, 0.0);
    std::fs::write(path("in.xyz"), &whole).expect("a file");
    // A tenth is gone, and a patch floats.
    let result = grid(40, |x, _| x < 36, 0.0) + &grid(12, |_, _| true, 9.0);
    std::fs::write(path("out.xyz"), result).expect("a file");
    let done = run(&["report", &path("in.xyz"), &path("out.xyz"), "--json", "-"]);
    let numbers: Value = serde_json::from_slice(&done.stdout).expect("JSON");
    assert_eq!(numbers["far"], 144.0 / (36.0 * 40.0 + 144.0));
    // A spacing is the mean of eight neighbours, 1.2 of the grid's: the first of four rows is within it.
    assert_eq!(numbers["lost"], 120.0 / 1600.0);
    let warnings = numbers["warnings"].to_string();
    assert!(
        warnings.contains("9.09 % of the result") && warnings.contains("7.50 % of the input"),
        "{warnings}"
    );
}

#[test]
fn what_a_file_says_is_text_on_the_page() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    let rows: String = (0..400).map(|i| format!("{} {} 0\n", i % 20, i / 20)).collect();
    let head = "ply\nformat ascii 1.0\ncomment densecloud: <script>alert(1)</script>\nelement vertex 400\nproperty \
                float x\nproperty float y\nproperty float z\nend_header\n";
    let [cloud, page] = ["<b>.ply", "page.html"].map(&path);
    std::fs::write(&cloud, head.to_owned() + &rows).expect("a file");
    assert!(run(&["report", &cloud, &cloud, "--out", &page]).status.success());
    let text = std::fs::read_to_string(&page).expect("text");
    assert!(text.contains("&lt;script&gt;alert(1)") && text.contains("&lt;b&gt;.ply"));
    assert!(!text.contains("<script") && !text.contains("<b>"));
}

#[test]
fn what_cannot_be_reported_is_refused_before_any_work() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    std::fs::write(path("in.xyz"), crate::support::sphere(2000)).expect("a file");
    std::fs::write(path("one.xyz"), "1 2 3\n1 2 3\n").expect("a file");
    let (input, one) = (path("in.xyz"), path("one.xyz"));
    for (arguments, code, words) in [
        (vec!["report", &input, &input], 64, "--out"),
        (vec!["report", &input, &input, "-o", "page.pdf"], 64, "name it .html"),
        (vec!["report", &input, &input, "--json", "-", "--sensor", "1,2"], 64, "is not three numbers X,Y,Z"),
        (vec!["report", &input, &input, "--json", "-", "--sample", "0"], 64, "1 point or more"),
        (vec!["report", &input, &one, "--json", "-"], 1, "one.xyz"),
        (vec!["report", "-", "-", "--json", "-"], 64, "standard input"),
        (vec!["report", &input, &input, "--json", "-", "-o", "-"], 64, "standard output"),
        (vec!["upsample", &input, &one, "--report", "page.pdf"], 64, "name it .html"),
        (vec!["upsample", &input, &one, "--report", "p.html", "--tile-points", "1000"], 1, "--bounds"),
    ] {
        let done = run(&arguments);
        let told = String::from_utf8_lossy(&done.stderr);
        assert_eq!(done.status.code(), Some(code), "{arguments:?}: {told}");
        assert!(told.contains(words), "{arguments:?}: {told}");
    }
    assert_eq!(std::fs::read_to_string(&one).expect("text"), "1 2 3\n1 2 3\n", "nothing is written");
}
