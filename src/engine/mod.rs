//! Queue, workers, progress and cancellation.
