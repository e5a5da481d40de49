"""An S3 in memory (moto) for tests: tells its endpoint in a file once the bucket is there, and stays until it is ended.

python scripts/s3_stand_in.py FILE BUCKET
"""

import pathlib
import signal
import sys

import boto3
from moto.server import ThreadedMotoServer


def main() -> None:
    file, bucket = pathlib.Path(sys.argv[1]), sys.argv[2]
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    endpoint = f"http://{host}:{port}"
    keys = {"aws_access_key_id": "test", "aws_secret_access_key": "test", "region_name": "us-east-1"}
    boto3.client("s3", endpoint_url=endpoint, **keys).create_bucket(Bucket=bucket)
    # Under another name until it is whole.
    whole = file.with_suffix(".new")
    whole.write_text(endpoint)
    whole.rename(file)
    signal.pause()


if __name__ == "__main__":
    main()
