//! The unit of the cascade as the rest of the program sees it, and the runtimes behind it.
