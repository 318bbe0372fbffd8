"""A scheduled PID as readable source text: C99 for a microcontroller, IEC 61131-3 Structured Text for a PLC."""
