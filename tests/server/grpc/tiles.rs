//! Clouds of more points than a tile.

use super::{asked, coordinates, file, npy, points, ratio, read, with_attributes};
use crate::support::{Scripted, Server, wait_until};
use crate::tiles::{Expected, config, expected};
use densecloud_formats::{Format, Scalar};
use densecloud_server::proto::NumberType;
use densecloud_server::proto::Options;

fn in_tiles() -> Options {
    let parameters = [("tile_points".to_owned(), "1000".to_owned())].into();
    Options { parameters, ..ratio(2.0) }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_result_in_tiles_is_that_of_http() {
    let temp = tempfile::tempdir().expect("a folder");
    let server = Server::start(&Scripted::new(), config(temp.path()));
    let mut cloud = with_attributes(3500);
    cloud.positions[9] = cloud.positions[8];
    let body = npy(&cloud, Scalar::F32);
    let Expected { file: whole, report, early } = expected(&body, &[("ratio", "2"), ("tile_points", "1000")]);
    let answer = asked(&server, file(in_tiles(), &body, 10_000)).await.expect("a result");
    assert!(answer.file == whole);
    let late: Vec<String> = report.warnings.iter().filter(|told| !early.contains(told)).cloned().collect();
    assert!(answer.ending.as_ref() == Some(&late) && !late.is_empty(), "{late:?}");
    assert_eq!((answer.header.warnings.clone(), answer.header.points_out), (early, 7000));
    // The same as columns.
    let request = points(in_tiles(), &cloud, NumberType::Float32, 700);
    let answer = asked(&server, request).await.expect("a result");
    let made = read(&whole);
    assert!(answer.positions == coordinates(&made, NumberType::Float32));
    assert_eq!(answer.fields.len(), 3);
    assert!(answer.fields[0] == super::column(&made.attributes[0].values));
    assert_eq!(answer.ending, Some(late));
    // And what is only known at the end.
    let laz = Options {
        result: Some(densecloud_server::proto::options::Result::MediaType("application/vnd.laszip".into())),
        ..in_tiles()
    };
    let answer = asked(&server, file(laz, &body, 10_000)).await.expect("a result");
    assert_eq!(answer.header.media_type, Format::Las { compressed: true }.media_type());
    assert!(read(&answer.file).positions.len() == 7000 && answer.ending.is_none());
    tokio::task::block_in_place(|| {
        wait_until("the folders are removed", || {
            std::fs::read_dir(temp.path()).expect("a folder").count() == 0
        });
    });
}

#[tokio::test(flavor = "multi_thread")]
async fn a_failure_midway_is_the_calls_status() {
    let temp = tempfile::tempdir().expect("a folder");
    let backend = Scripted::new();
    let server = Server::start(&backend, config(temp.path()));
    let body = npy(&with_attributes(3500), Scalar::F32);
    let batches = crate::tiles::batches(&body, &[("ratio", "2"), ("tile_points", "1000")]);
    backend.shut();
    (0..batches[1]).for_each(|_| backend.pass());
    let mut client = super::client(&server);
    let call = client.upsample(futures::stream::iter(file(in_tiles(), &body, 10_000)));
    let mut stream = call.await.expect("a call").into_inner();
    let mut chunks = 0;
    while chunks == 0 {
        let message = stream.message().await.expect("no failure yet").expect("more to come");
        chunks += usize::from(matches!(message.message, Some(super::Out::FileChunk(_))));
    }
    backend.fail();
    backend.open();
    let status = loop {
        match stream.message().await {
            Ok(Some(_)) => {}
            Ok(None) => panic!("it looks whole"),
            Err(status) => break status,
        }
    };
    assert_eq!(status.code(), tonic::Code::Internal, "{status:?}");
    assert!(!status.message().contains("secret"), "{status:?}");
}
