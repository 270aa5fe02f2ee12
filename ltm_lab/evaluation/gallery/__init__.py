"""Study wing: real photos, chosen by rule, with what the system makes of them and what is wrong with it."""
