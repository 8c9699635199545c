"""Extraction: shapes and features of many recorded episodes, into tables."""
