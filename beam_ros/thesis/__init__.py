"""The reference work, reproduced: its tables and figures from bags, numbered as there, with intervals."""
