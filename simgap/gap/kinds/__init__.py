"""The kinds of bases: each a frozen section of a case that lists its terms [plug-ins]."""
