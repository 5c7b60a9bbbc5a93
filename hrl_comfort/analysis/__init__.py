"""Analysis: intervals, tables, comfort responses. No matplotlib here."""
