//! Text of which nothing is left out without a word.

use super::*;

fn cloud(text: &str) -> Cloud {
    read(text.as_bytes()).unwrap_or_else(|why| panic!("{text:?}: {why}"))
}

#[test]
fn lines_before_the_points_that_hold_numbers_are_told_or_refused() {
    let told = |text: &str| cloud(text).notes;
    assert_eq!(told("A 1 2 3\n1 2 3\n4 5 6\n"), ["line 1 is not taken for a point: `A 1 2 3`"]);
    assert_eq!(told("A 1 2 3\nx y z\n1 2 3\n4 5 6\n"), ["line 1 is not taken for a point: `A 1 2 3`"]);
    assert_eq!(told("Mill 7\nid x y z\n1 2 3 4\n5 6 7 8\n"), ["line 1 is not taken for a point: `Mill 7`"]);
    for quiet in ["My survey\n1 2 3\n4 5 6\n", "2\n1 2 3\n4 5 6\n", "# 7 8 9\n1 2 3\n4 5 6\n"] {
        assert!(told(quiet).is_empty(), "{quiet:?}");
    }
    // Numbers where the coordinates stand.
    let broken = read(b"A 7 8 9 B\nid x y z\n1 2 3 4\n5 6 7 8\n").expect_err("a point").to_string();
    assert!(broken.starts_with("line 1: 5 columns where the points have 4"), "{broken}");
}

#[test]
fn what_stands_behind_the_mark_of_a_comment_on_every_line_is_told() {
    let rows = |end: &str| format!("1 2 3{end}\n4 5 6{end}\n7 8 9{end}\n");
    let colours = cloud(&rows(" #ff0000 7"));
    assert_eq!((colours.positions.len(), colours.attributes.len()), (3, 0));
    assert_eq!(
        colours.notes,
        [
            "3 of the first 3 points end in a comment, which is left out: `#ff0000 7`; if it is data, write it without `#` and `//`"
        ]
    );
    for (separated, count) in [
        ("x,y,z\n1,2,3 // 7\n4,5,6 // 8\n", "2 of the first 2"),
        ("\"1\" 2 3 # a\n4 5 6 # b\n", "2 of the first 2"),
    ] {
        let notes = cloud(separated).notes;
        assert!(notes.len() == 1 && notes[0].starts_with(count), "{separated:?}: {notes:?}");
    }
    assert!(cloud("1 2 3 # first\n4 5 6\n7 8 9\n").notes.is_empty());
    assert!(cloud(&rows("")).notes.is_empty() && cloud("1,2,3,\n4,5,6,\n").notes.is_empty());
}

#[test]
fn what_is_told_once_is_told_before_what_is_told_often() {
    let text: String = (0..500).map(|i| format!("2\n{i} 2 3 4\n")).collect();
    let notes = cloud(&text).notes;
    assert_eq!(notes.len(), 20);
    assert_eq!(notes[0], "the file has 500 clouds; `scan` numbers them from 0");
    assert_eq!(notes[1], "line 1 counts 2 points, and 1 follow it; all of them are read");
    assert_eq!(notes[19], "and 482 more of this kind");
    let reading = Reading { axes: Some("x,y,z".parse().expect("axes")), ..Reading::default() };
    let many = "property uchar red\n".repeat(100);
    let ply = format!(
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n{many}\
         end_header\n1 2 3{}\n",
        " 7".repeat(100)
    );
    let notes = CloudReader::open_as(ply.as_bytes(), Limits::default(), &reading)
        .and_then(CloudReader::read)
        .expect("a cloud")
        .notes;
    assert!(notes.len() == 20 && notes[0].starts_with("--axes: for text"), "{notes:?}");
    assert_eq!(notes[19], "and 81 more of this kind");
}
