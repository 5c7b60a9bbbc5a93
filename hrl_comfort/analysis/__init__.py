"""Analysis: intervals, tables, comfort responses. EpisodeSampler nothing."""
