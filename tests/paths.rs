//! Every path that a document or a comment names leads somewhere.

use std::path::{Path, PathBuf};

/// What a path ends with, where it is one of the repository's files.
const ENDINGS: [&str; 16] = [
    ".html", ".json", ".md", ".onnx", ".pt", ".png", ".proto", ".py", ".rs", ".service", ".sh", ".toml",
    ".txt", ".yaml", ".yml", "/",
];

/// What is made by commands, or stands for a file of the reader's.
const MADE: [&str; 8] =
    ["target/", "out/", "vendor/", ".venv", "training/runs/", "training/data/", "fuzz/corpus/", "runs/"];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// Documents and sources of the repository, what is made in it aside.
fn files(folder: &Path, into: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if path.is_dir() {
            let skipped = ["target", "vendor", "out", "runs", "node_modules", "corpus"];
            if !name.starts_with('.') && !skipped.contains(&name.as_str()) {
                files(&path, into);
            }
        } else if name.ends_with(".md") || name.ends_with(".rs") {
            into.push(path);
        }
    }
}

/// What stands in backticks, and what links lead to.
fn mentions(text: &str) -> impl Iterator<Item = &str> {
    let quoted = text.split('`').skip(1).step_by(2);
    let linked = text.split("](").skip(1).filter_map(|rest| rest.split([')', '#']).next());
    quoted.chain(linked)
}

/// Whether a mention is a path in this repository, by its looks.
fn is_path(mention: &str) -> bool {
    let plain = |c: char| c.is_ascii_alphanumeric() || "_-./".contains(c);
    // A folder's name alone is a word about the line's subject.
    mention.trim_end_matches('/').contains('/')
        && mention.chars().all(plain)
        && ENDINGS.iter().any(|ending| mention.ends_with(ending))
        && !mention.starts_with('/')
        && !MADE.iter().any(|made| mention.starts_with(made))
}

/// Where a file's paths may begin: at the root, in its own folder, or in those above it.
fn leads_somewhere(mention: &str, file: &Path, root: &Path) -> bool {
    let above = file.ancestors().skip(1).take_while(|folder| folder.starts_with(root));
    above.chain([root]).any(|folder| folder.join(mention).exists())
}

#[test]
fn every_path_in_documents_and_comments_leads_somewhere() {
    let root = root().canonicalize().expect("the repository");
    let mut all = Vec::new();
    files(&root, &mut all);
    let (mut seen, mut lost) = (0, Vec::new());
    for file in &all {
        let text = std::fs::read_to_string(file).expect("a text");
        let is_code = file.extension().is_some_and(|extension| extension == "rs");
        for (number, line) in text.lines().enumerate() {
            let line = if is_code { line.find("//").map_or("", |at| &line[at..]) } else { line };
            for mention in mentions(line).filter(|mention| is_path(mention)) {
                seen += 1;
                if !leads_somewhere(mention, file, &root) {
                    let file = file.strip_prefix(&root).unwrap_or(file).display();
                    lost.push(format!("{file}:{}: {mention}", number + 1));
                }
            }
        }
    }
    assert!(lost.is_empty(), "{} of {seen} paths lead nowhere:\n{}", lost.len(), lost.join("\n"));
    assert!(seen > 100, "only {seen} paths were found");
}

#[test]
fn every_document_is_a_chapter_of_the_book() {
    let root = root();
    let summary = std::fs::read_to_string(root.join("docs/book/SUMMARY.md")).expect("a text");
    let chapters: Vec<&str> = mentions(&summary).collect();
    let mut all = Vec::new();
    files(&root.join("docs"), &mut all);
    for file in all.iter().filter(|file| !file.ends_with("SUMMARY.md")) {
        let name = file.strip_prefix(&root).expect("within").to_string_lossy().into_owned();
        assert!(chapters.contains(&name.as_str()), "{name} is not in docs/book/SUMMARY.md");
    }
}
