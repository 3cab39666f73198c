"""Import of measured runs: conversion of the CSV of an on-board recorder to a profile and a run folder."""
