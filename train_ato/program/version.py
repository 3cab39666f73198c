"""The version, declared once; setup.py and package.xml are checked against it by a test."""

VERSION = "0.2.0"
