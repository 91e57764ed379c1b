"""Many steps at a time, by heyoka in batches."""
